"""What the index of runs wants to know of a recording."""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from acquisition.recordings.container import Container, Told
from acquisition.recordings.layout import RAW
from app.record.topics import ALARM, GRASP, JOURNAL, RUN, read
from app.wire import Alarm, FileCondition, FileRecord, GraspEnded, JournalEntry, Run
from config.errors import RecordingError

Message = Run | GraspEnded | Alarm | JournalEntry


def recorded_messages(path: Path) -> Iterator[tuple[str | None, Message]]:
    """What was told while it was recorded, in order, each with the run it belongs to.

    Raises:
        RecordingError: the file is damaged from here on.
    """
    container = Container(path)
    run_id = container.about.get("run_id")
    for told in container.read(RUN, GRASP, ALARM, JOURNAL):
        assert isinstance(told, Told)
        try:
            message = read(told.topic, told.content)
        except ValueError as error:
            raise RecordingError(f"{path}: holds a message that cannot be read ({error}).") from None
        if isinstance(message, Message):
            yield run_id, message


def recorded_file(path: Path) -> FileRecord:
    """The file as a whole; one that cannot be read is a record too."""
    stat = path.stat()
    known = FileRecord(
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
    try:
        container = Container(path)
    except RecordingError as error:
        return known.model_copy(update={"problem": str(error).replace(str(path), path.name)})
    about, ended = container.about, container.ended
    condition = FileCondition.COMPLETE if container.complete else FileCondition.CUT_OFF
    samples, lost = container.message_counts.get(RAW), ended.get("lost_samples")
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
