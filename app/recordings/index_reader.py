"""Functions that read recordings for the index of runs."""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from acquisition.recordings.mcap_layout import RAW_TOPIC
from acquisition.recordings.mcap_reader import JsonMessage, McapFile
from app.index.rebuild import RecordingReader
from app.messages.alarms import Alarm
from app.messages.grasps import GraspEnded
from app.messages.journal import JournalEntry
from app.messages.recordings import FileCondition, FileRecord
from app.messages.runs import Run
from app.recordings.mcap_writer import RECORDING_SUFFIX
from app.recordings.topics import ALARM_TOPIC, GRASP_TOPIC, JOURNAL_TOPIC, RUN_TOPIC, decode_message
from config.errors import RecordingError

RecordedMessage = Run | GraspEnded | Alarm | JournalEntry


def read_recorded_messages(path: Path) -> Iterator[tuple[str | None, RecordedMessage]]:
    """Yield the recorded messages in order, each with the id of the recording's run.

    Raises:
        RecordingError: the file is damaged from here on.
    """
    container = McapFile(path)
    run_id = container.metadata.get("run_id")
    for told in container.iter_content(RUN_TOPIC, GRASP_TOPIC, ALARM_TOPIC, JOURNAL_TOPIC):
        assert isinstance(told, JsonMessage)
        try:
            message = decode_message(told.topic, told.content)
        except ValueError as error:
            raise RecordingError(f"{path}: holds a message that cannot be read ({error}).") from None
        if isinstance(message, RecordedMessage):
            yield run_id, message


def describe_file(path: Path) -> FileRecord:
    """Return the record of a file whose content is not read, from its name, size and time."""
    stat = path.lstat()
    return FileRecord(
        name=path.name,
        run_id=None,
        size_bytes=stat.st_size,
        made_at=datetime.fromtimestamp(stat.st_mtime, UTC).isoformat(timespec="seconds"),
        duration_s=None,
        samples=None,
        lost_samples=None,
        format_version=None,
        condition=None,
        problem=None,
    )


def read_file_record(path: Path) -> FileRecord:
    """Return the record of the file; one that cannot be read gets a record with its problem."""
    known = describe_file(path)
    try:
        container = McapFile(path)
    except RecordingError as error:
        return known.model_copy(update={"problem": str(error).replace(str(path), path.name)})
    about, ended = container.metadata, container.end_metadata
    condition = FileCondition.COMPLETE if container.complete else FileCondition.CUT_OFF
    samples, lost = container.message_counts.get(RAW_TOPIC), ended.get("lost_samples")
    try:
        duration_s = None if samples is None else samples / float(about.get("sample_rate_hz", "nan"))
        lost_samples = None if lost is None else int(lost)
    except (ValueError, ZeroDivisionError):
        return known.model_copy(update={"problem": f"{path.name}: does not hold what a run's file says of itself."})
    return known.model_copy(
        update={
            "run_id": about.get("run_id"),
            "format_version": about.get("format_version"),
            "samples": samples,
            "duration_s": duration_s,
            "lost_samples": lost_samples,
            "condition": FileCondition.RECOVERED if ended.get("cut_off") else condition,
        }
    )


RECORDING_READERS = (RecordingReader(RECORDING_SUFFIX, read_recorded_messages, read_file_record),)
