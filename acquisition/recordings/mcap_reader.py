"""The class McapFile, which reads Graspwatch's MCAP files, whole or cut off: metadata, attachments, rows, messages.

The `mcap` package reads the records; numpy reads the many rows of equal length inside a chunk.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader
from zstandard import ZstdError

from acquisition.recordings.mcap_chunks import decompress_chunk
from acquisition.recordings.mcap_layout import END_METADATA_NAME, FORMAT_VERSION, METADATA_NAME, PROFILE
from acquisition.recordings.protobuf_rows import RowLayout
from config.errors import RecordingError

MAGIC = b"\x89MCAP0\r\n"
RECORD_LIMIT_BYTES = 256 * 2**20  # records of Graspwatch have a few MiB; a damaged length must not allocate all memory
MESSAGE_HEADER_DTYPE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_ns", "<u8"),
        ("publish_ns", "<u8"),
    ]
)
_READ_RECORD_TYPES: dict[int, type[Header | Metadata | Attachment | Chunk]] = {
    Opcode.HEADER: Header,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
    Opcode.CHUNK: Chunk,
}
_DECLARATION_TYPES: dict[int, type[Schema | Channel]] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
DAMAGE_ERRORS = (McapError, ZstdError, DecodeError, LookupError, ValueError, OverflowError, MemoryError, struct.error)
COPY_AGAIN_TEXT = "Copy it again from where it was recorded."


@dataclass(frozen=True, slots=True)
class RowBlock:
    """Consecutive rows of one topic: columns of shape (n,) by their path, each row's block number and times."""

    topic: str
    columns: dict[str, np.ndarray]
    sequence: np.ndarray
    log_ns: np.ndarray
    publish_ns: np.ndarray

    def __len__(self) -> int:
        return len(self.sequence)


@dataclass(frozen=True, slots=True)
class JsonMessage:
    """One JSON message of an MCAP file: topic, time of logging, and content."""

    topic: str
    log_ns: int
    content: bytes


@dataclass(slots=True)
class _ChannelRegistry:
    """Schemas and channels declared so far; a file declares everything before it uses it."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)
    layouts: dict[int, RowLayout] = field(default_factory=dict)  # by channel; a JSON channel has none

    def declare(self, record: Schema | Channel) -> None:
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif record.id not in self.topics:
            self.topics[record.id] = record.topic
            if record.message_encoding == "protobuf":
                schema = self.schemas[record.schema_id]
                self.layouts[record.id] = RowLayout.from_schema(schema.name, schema.data)


class McapFile:
    """One MCAP file of Graspwatch. Opening it reads `metadata` and `attachments`; methods read the rest."""

    def __init__(self, path: Path) -> None:
        """Open and check the file.

        Raises:
            RecordingError: the file cannot be read, is no MCAP file, not one of Graspwatch, or of a later format.
        """
        self.path = path
        self.metadata: dict[str, str] = {}
        self.end_metadata: dict[str, str] = {}
        self.attachments: dict[str, bytes] = {}
        self.message_counts: dict[str, int] = {}
        profile = ""
        for record in self.iter_records():
            match record:
                case Header():
                    profile = record.profile
                case Metadata() if record.name == METADATA_NAME:
                    self.metadata = record.metadata
                case Attachment():
                    self.attachments[record.name] = record.data
                case Chunk():
                    break
        self._check_profile(profile)
        self.complete = self._read_end()

    def _check_profile(self, profile: str) -> None:
        if profile != PROFILE:
            what = f"its profile is {profile!r}" if profile else "it names no profile"
            raise RecordingError(f"{self.path}: is an MCAP file, but no recording of Graspwatch ({what}).")
        version = self.metadata.get("format_version", "")
        known = version.isdecimal() and len(version) < 10
        if known and int(version) > FORMAT_VERSION:
            raise RecordingError(
                f"{self.path}: was recorded by a later Graspwatch ({self.metadata.get('graspwatch', '?')}, format "
                f"{version}; this one reads up to {FORMAT_VERSION}). Update Graspwatch."
            )
        if not known:
            raise RecordingError(f"{self.path}: holds no description of what was recorded. {COPY_AGAIN_TEXT}")

    def _read_end(self) -> bool:
        """Read the summary; return False if the file was cut off before its summary."""
        try:
            with self.path.open("rb") as file:
                file.seek(-len(MAGIC), 2)
                if file.read() != MAGIC:
                    return False
                file.seek(-len(MAGIC) - 29, 2)  # opcode, length, and the footer's three numbers
                opcode, _, summary_start, _, _ = struct.unpack("<BQQQI", file.read(29))
                if opcode != Opcode.FOOTER or not summary_start:
                    return False
                file.seek(summary_start)
                self._read_summary(file)
        except (OSError, *DAMAGE_ERRORS) as error:
            raise RecordingError(f"{self.path}: its end is damaged ({error}). {COPY_AGAIN_TEXT}") from None
        return True

    def _read_summary(self, file: BinaryIO) -> None:
        topics: dict[int, str] = {}
        ended_at = 0
        for record in StreamReader(file, skip_magic=True, record_size_limit=RECORD_LIMIT_BYTES).records:
            match record:
                case Channel():
                    topics[record.id] = record.topic
                case Statistics():
                    counts = record.channel_message_counts
                    self.message_counts = {topic: counts.get(channel, 0) for channel, topic in topics.items()}
                case MetadataIndex() if record.name == END_METADATA_NAME:
                    ended_at = record.offset
                case Footer():
                    break
        if ended_at:
            file.seek(ended_at)
            record = next(iter(StreamReader(file, skip_magic=True, record_size_limit=RECORD_LIMIT_BYTES).records), None)
            if not isinstance(record, Metadata):
                raise ValueError("it names a place where nothing is")
            self.end_metadata = record.metadata

    def iter_records(self) -> Iterator[McapRecord]:
        """Yield all records in their order, to the file's end or to where it was cut off.

        Raises:
            RecordingError: the file is damaged; the text names the place.
        """
        try:
            with self.path.open("rb") as file:
                magic = file.read(len(MAGIC))
                if magic != MAGIC:
                    what = "is no MCAP file" if magic else "is empty"
                    raise RecordingError(f"{self.path}: {what}. {COPY_AGAIN_TEXT}")
                yield from _iter_records(file)
        except FileNotFoundError:
            raise RecordingError(f"{self.path}: there is no such file. Check the path.") from None
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read ({error.strerror}).") from None
        except DAMAGE_ERRORS as error:
            raise RecordingError(f"{self.path}: is damaged ({error}). {COPY_AGAIN_TEXT}") from None

    def iter_content(self, *topics: str) -> Iterator[RowBlock | JsonMessage]:
        """Yield the content of all whole chunks under these topics, in the order in which it was written.

        Raises:
            RecordingError: the file is damaged; the text names the place.
        """
        wanted = set(topics)
        channels = _ChannelRegistry()
        for number, record in enumerate(record for record in self.iter_records() if isinstance(record, Chunk)):
            try:
                yield from _iter_chunk_content(decompress_chunk(record), channels, wanted)
            except DAMAGE_ERRORS as error:
                raise RecordingError(
                    f"{self.path}: piece {number + 1} of its samples is damaged ({error}). {COPY_AGAIN_TEXT}"
                ) from None

    def read_rows(self, topic: str) -> RowBlock:
        """Return all rows of one topic.

        Raises:
            RecordingError: the file is damaged, or has no rows of the topic.
        """
        pieces = [piece for piece in self.iter_content(topic) if isinstance(piece, RowBlock)]
        if not pieces:
            raise RecordingError(f"{self.path}: holds no samples ({topic}): it was cut off before the first second.")
        return concatenate_rows(pieces)


def _iter_records(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of `_READ_RECORD_TYPES`, to the footer or to where the file was cut off.

    The `mcap` package's reader also parses the message indexes, which took half of the time of a replay.
    """
    while len(head := file.read(9)) == 9:
        opcode, length = struct.unpack("<BQ", head)
        if length > RECORD_LIMIT_BYTES:
            raise ValueError(f"a record of {length} bytes")
        if opcode == Opcode.FOOTER:
            return
        if opcode not in _READ_RECORD_TYPES:
            file.seek(length, 1)
            continue
        content = file.read(length)
        if len(content) < length:
            return
        yield _READ_RECORD_TYPES[opcode].read(ReadDataStream(BytesIO(content)))


def concatenate_rows(pieces: list[RowBlock]) -> RowBlock:
    """Return the rows of all pieces, which have one topic, in one block."""
    columns = {name: np.concatenate([each.columns[name] for each in pieces]) for name in pieces[0].columns}
    others = [np.concatenate([getattr(each, name) for each in pieces]) for name in ("sequence", "log_ns", "publish_ns")]
    return RowBlock(pieces[0].topic, columns, *others)


def _iter_chunk_content(data: bytes, channels: _ChannelRegistry, wanted: set[str]) -> Iterator[RowBlock | JsonMessage]:
    """Yield a chunk's content under the wanted topics, and add its declarations to `channels`."""
    at, head_bytes = 0, MESSAGE_HEADER_DTYPE.itemsize
    while at < len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        end = at + 9 + length
        if end > len(data):
            raise ValueError("a record goes beyond its end")
        if opcode != Opcode.MESSAGE:
            if opcode in _DECLARATION_TYPES:
                channels.declare(_DECLARATION_TYPES[opcode].read(ReadDataStream(BytesIO(data[at + 9 : end]))))
            at = end
            continue
        channel = int.from_bytes(data[at + 9 : at + 11], "little")
        layout = channels.layouts.get(channel)
        topic = channels.topics[channel]
        if layout is None:
            if topic in wanted:
                message = np.frombuffer(data, MESSAGE_HEADER_DTYPE, 1, at)[0]
                yield JsonMessage(topic, int(message["log_ns"]), data[at + head_bytes : end])
            at = end
            continue
        rows = np.frombuffer(data, _message_dtype(layout), (len(data) - at) // (end - at), at)
        head = rows["head"]
        alike = (head["opcode"] == opcode) & (head["length"] == length) & (head["channel"] == channel)
        count = len(rows) if alike.all() else int(np.argmin(alike))
        if length != head_bytes - 9 + layout.row_bytes:
            raise ValueError(f"a message of {topic} has another length than its schema says")
        if topic in wanted:
            rows, head = rows[:count], head[:count]
            columns = layout.decode(rows["row"].tobytes())
            yield RowBlock(topic, columns, *(head[name].copy() for name in ("sequence", "log_ns", "publish_ns")))
        at += count * (end - at)


def _message_dtype(layout: RowLayout) -> np.dtype:
    """Return the dtype of a message record: its header and a row."""
    return np.dtype([("head", MESSAGE_HEADER_DTYPE), ("row", f"V{layout.row_bytes}")])
