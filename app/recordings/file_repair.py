"""Functions that repair recordings that were cut off: they keep all up to the last whole chunk, and get a summary."""

import fcntl
import logging
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import CompressionType, Writer

from acquisition.recordings import mcap_layout
from acquisition.recordings.mcap_chunks import decompress_chunk
from acquisition.recordings.mcap_reader import COPY_AGAIN_TEXT, DAMAGE_ERRORS, McapFile
from config.errors import RecordingError

CHUNK_BYTES = 256 * 2**10
TEMPORARY_SUFFIX = ".mending"


def recover_folder(folder: Path) -> Iterator[Path]:
    """Repair every cut-off file of a folder, and yield its path; log and leave those that cannot be repaired."""
    for leftover in folder.glob(f"*{TEMPORARY_SUFFIX}"):
        leftover.unlink(missing_ok=True)
    for path in sorted(folder.glob("*.mcap")):
        try:
            if recover_file(path):
                yield path
        except (RecordingError, OSError) as error:
            logging.getLogger("graspwatch").warning("%s stays as it is: %s", path.name, error)


def recover_file(path: Path) -> bool:
    """Replace one cut-off file by its repaired copy; return False if it is complete or still being written.

    Raises:
        RecordingError: it is no recording of Graspwatch, or is damaged.
        OSError: there is no room for the repaired file.
    """
    container = McapFile(path)
    if container.complete or _is_being_written(path):
        return False
    provisional = path.with_name(path.name + TEMPORARY_SUFFIX)
    try:
        with provisional.open("xb") as file:
            _copy_records(container, Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD))
            file.flush()
            os.fsync(file.fileno())
        os.utime(provisional, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns))
        os.replace(provisional, path)
    except DAMAGE_ERRORS as error:
        raise RecordingError(f"{path}: is damaged ({error!r}). {COPY_AGAIN_TEXT}") from None
    finally:
        provisional.unlink(missing_ok=True)
    return True


def _is_being_written(path: Path) -> bool:
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _copy_records(container: McapFile, writer: Writer) -> None:
    writer.start(mcap_layout.PROFILE, "graspwatch")
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for record in container.iter_records():
        match record:
            case Metadata():
                writer.add_metadata(record.name, record.metadata)
            case Attachment():
                writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            case Chunk():
                try:
                    inner = breakup_chunk(replace(record, compression="", data=decompress_chunk(record)))
                except DAMAGE_ERRORS:
                    break  # the chunk that was being written
                for each in inner:
                    _copy_record(each, writer, schemas, channels)
    writer.add_metadata(
        mcap_layout.END_METADATA_NAME, {"why": "it was cut off, and made whole later", "cut_off": "true"}
    )
    writer.finish()


def _copy_record(record: McapRecord, writer: Writer, schemas: dict[int, int], channels: dict[int, int]) -> None:
    match record:
        case Schema():
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        case Channel():
            channels[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
            )
        case Message():
            writer.add_message(
                channels[record.channel_id], record.log_time, record.data, record.publish_time, record.sequence
            )
