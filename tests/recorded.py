"""Recordings in a format for these tests only: one line of JSON for each message."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from app.index.ingest import IndexedMessage
from app.index.rebuild import RecordingReader
from app.messages.alarms import Alarm
from app.messages.grasps import GraspEnded
from app.messages.journal import JournalEntry
from app.messages.recordings import FileRecord
from app.messages.runs import Run
from config.errors import RecordingError

KINDS = {kind.__name__: kind for kind in (Alarm, GraspEnded, JournalEntry, Run)}


def write_recording(data: Path, record: FileRecord, messages: Iterable[IndexedMessage]) -> Path:
    path = data / "recordings" / record.name
    path.parent.mkdir(exist_ok=True)
    lines = [json.dumps([type(message).__name__, message.model_dump_json()]) for message in messages]
    path.write_text("\n".join([record.model_dump_json(), *lines]) + "\n")
    return path


def recorded_messages(path: Path) -> Iterator[tuple[str | None, IndexedMessage]]:
    head, *lines = path.read_text().splitlines()
    run_id = FileRecord.model_validate_json(head).run_id
    for number, line in enumerate(lines, 2):
        try:
            kind, content = json.loads(line)
        except ValueError:
            raise RecordingError(f"{path.name}, line {number}: is no message") from None
        yield run_id, KINDS[kind].model_validate_json(content)


def recorded_file(path: Path) -> FileRecord:
    return FileRecord.model_validate_json(path.read_text().splitlines()[0])


READERS = (RecordingReader(".rec", recorded_messages, recorded_file),)
