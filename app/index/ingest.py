"""Functions that put records into the index's tables. A record that is put in twice changes nothing.

Runs, grasps, alarms and journal lines may come in any order: the newest message of each wins. Of a recording's file the
last message wins, because it describes the present state.
"""

import hashlib
import json
from datetime import UTC, datetime
from typing import Any, TypeVar

from sqlalchemy.orm import Session

from app.index.tables import AlarmRow, AuditRow, FileRow, GraspRow, IndexTable, LabSessionRow, MarkRow, RunRow, TruthRow
from app.messages.alarms import Alarm
from app.messages.annotations import GraspTruth, Mark
from app.messages.base import Record
from app.messages.grasps import GraspEnded
from app.messages.journal import RECORD_FIELDS, JournalEntry
from app.messages.lab_sessions import LabSession
from app.messages.recordings import FileRecord
from app.messages.runs import Run, RunState
from app.messages.stored import read_stored

Row = TypeVar("Row", bound=IndexTable)
IndexedMessage = Run | GraspEnded | GraspTruth | Mark | LabSession | Alarm | JournalEntry | FileRecord


def ingest(session: Session, message: IndexedMessage, run_id: str | None = None) -> None:
    """Put one message into the index; `run_id` is the run of a grasp message without one.

    Raises:
        TypeError: there is no table for such a message.
    """
    match message:
        case Run():
            _ingest_run(session, message)
        case GraspEnded():
            _ingest_grasp(session, message, message.run_id or run_id)
        case GraspTruth():
            _ingest_truth(session, message)
        case Mark():
            _ingest_mark(session, message)
        case LabSession():
            _ingest_lab_session(session, message)
        case Alarm():
            _ingest_alarm(session, message)
        case JournalEntry():
            _ingest_journal_entry(session, message)
        case FileRecord():
            _ingest_file_record(session, message)
        case _:
            raise TypeError(f"{type(message).__name__} is nothing for the index")
    session.flush()


def parse_iso_ms(moment: str) -> float:
    """Return an ISO 8601 time as milliseconds since 1970, with fractions; without a time zone it is UTC."""
    found = datetime.fromisoformat(moment)
    return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp() * 1e3


FIRST_DEFAULTED_FIELDS = {"type", "change", "deleted_at", "deleted_by"}
"""Fields with a default that the records inside journal lines had from the beginning."""


def line_key(entry: JournalEntry) -> str:
    """Return the key of a journal line: a hash of its content without its place in the chain.

    A field that a later version adds to a record changes no key of an older line, which has the default.
    """
    exclude = {}
    for name in RECORD_FIELDS:
        if about := getattr(entry, name):
            exclude[name] = _find_added_defaults(about)
    return hashlib.sha256(entry.without_chain().to_line(exclude).encode()).hexdigest()


def _find_added_defaults(record: Record) -> set[str]:
    fields = {name: field for name, field in type(record).model_fields.items() if not field.is_required()}
    return {
        name
        for name, field in fields.items()
        if name not in FIRST_DEFAULTED_FIELDS and getattr(record, name) == field.default
    }


def _to_json_text(message: Record) -> str:
    return message.model_dump_json()


def _to_json_dict(message: Record) -> dict[str, Any]:
    return json.loads(message.model_dump_json())


def _replace_nul(text: str | None) -> str | None:
    """Replace NUL, which PostgreSQL refuses in texts; the row's JSON message keeps it."""
    return text.replace("\0", "\ufffd") if text is not None else None


def _get_row(session: Session, table: type[Row], *key: Any) -> Row | None:
    return session.get(table, key[0] if len(key) == 1 else key)


def _get_or_add_run_row(session: Session, run_id: str) -> RunRow:
    """Return a run's row; a grasp may create it before the run's own message comes."""
    row = _get_row(session, RunRow, run_id)
    if row is None:
        row = RunRow(id=run_id, grasps=0)
        session.add(row)
    return row


def _ingest_run(session: Session, run: Run) -> None:
    row = _get_or_add_run_row(session, run.id)
    row.grasps = max(row.grasps, run.grasps)
    run = run.model_copy(update={"grasps": 0})  # counted in its column
    if row.message is not None and _run_recency(read_stored(Run, row.message)) >= _run_recency(run):
        return
    row.protocol, row.tissue, row.by = _replace_nul(run.protocol), _replace_nul(run.tissue), _replace_nul(run.by)
    row.state, row.why, row.session = run.state.value, _replace_nul(run.why), _replace_nul(run.session)
    row.started_ms = parse_iso_ms(run.started_at)
    row.ended_ms = parse_iso_ms(run.ended_at) if run.ended_at else None
    row.message = _to_json_dict(run)


def _run_recency(run: Run) -> tuple[bool, str, str]:
    """Return a sort key, in which a run that is over is newer than one under way."""
    return run.state is not RunState.RUNNING, run.ended_at or "", _to_json_text(run)


def _ingest_grasp(session: Session, ended: GraspEnded, run_id: str | None) -> None:
    if run_id is None:
        return  # a grasp of no run cannot be queried
    grasp, run = ended.grasp, _get_or_add_run_row(session, run_id)
    run.grasps = max(run.grasps, grasp.index)
    session.flush()
    row = _get_row(session, GraspRow, run_id, grasp.index)
    ended = ended.model_copy(update={"run_id": run_id})
    if row is None:
        row = GraspRow(run_id=run_id, index=grasp.index)
        session.add(row)
    elif _grasp_recency(read_stored(GraspEnded, row.message)) >= _grasp_recency(ended):
        return
    row.label, row.probability, row.peak_force_n = grasp.label, grasp.probability, grasp.peak_force_n
    row.valid, row.held_back = grasp.valid, grasp.held_back
    row.message = _to_json_dict(ended)


def _grasp_recency(ended: GraspEnded) -> tuple[float, str]:
    return ended.grasp.end_s, _to_json_text(ended)


def _ingest_truth(session: Session, truth: GraspTruth) -> None:
    row = _get_row(session, TruthRow, truth.run_id, truth.grasp)
    if row is None:
        row = TruthRow(run_id=truth.run_id, grasp=truth.grasp)
        session.add(row)
    elif _change_recency(read_stored(GraspTruth, row.message)) >= _change_recency(truth):
        return
    row.held, row.remark, row.version = truth.held, truth.remark and truth.remark.value, truth.version
    row.message = _to_json_dict(truth)


def _ingest_mark(session: Session, mark: Mark) -> None:
    row = _get_row(session, MarkRow, mark.id)
    if row is None:
        row = MarkRow(id=mark.id)
        session.add(row)
    elif _change_recency(read_stored(Mark, row.message)) >= _change_recency(mark):
        return
    row.run_id, row.at_s, row.text = mark.run_id, mark.at_s, _replace_nul(mark.text) or ""
    row.deleted, row.version, row.message = mark.deleted, mark.version, _to_json_dict(mark)


def _ingest_lab_session(session: Session, lab_session: LabSession) -> None:
    row = _get_row(session, LabSessionRow, lab_session.id)
    if row is None:
        row = LabSessionRow(id=lab_session.id)
        session.add(row)
    elif _change_recency(read_stored(LabSession, row.message)) >= _change_recency(lab_session):
        return
    row.subject, row.species = _replace_nul(lab_session.subject) or "", _replace_nul(lab_session.species)
    row.condition, row.began_ms = lab_session.condition.value, parse_iso_ms(lab_session.began_at)
    row.ended_ms = parse_iso_ms(lab_session.ended_at) if lab_session.ended_at else None
    row.version, row.message = lab_session.version, _to_json_dict(lab_session)


def _change_recency(changed: GraspTruth | Mark | LabSession) -> tuple[int, str]:
    return changed.version, _to_json_text(changed)


def _ingest_alarm(session: Session, alarm: Alarm) -> None:
    key = f"{alarm.began_ms:.3f}/{alarm.id}"
    row = _get_row(session, AlarmRow, key)
    if row is None:
        row = AlarmRow(key=key)
        session.add(row)
    elif _alarm_recency(read_stored(Alarm, row.message)) >= _alarm_recency(alarm):
        return
    row.kind, row.priority, row.active, row.text = alarm.kind.value, alarm.priority.value, alarm.active, alarm.text
    row.began_ms, row.ended_ms, row.change = alarm.began_ms, alarm.ended_ms, alarm.change
    row.acknowledged_by = _replace_nul(alarm.acknowledged_by)
    row.message = _to_json_dict(alarm)


def _alarm_recency(alarm: Alarm) -> tuple[int, str]:
    return alarm.change, _to_json_text(alarm)


def _ingest_journal_entry(session: Session, entry: JournalEntry) -> None:
    """Add a line and the messages in it; of a known line, only update its place in the chain."""
    key = line_key(entry)
    if row := _get_row(session, AuditRow, key):
        if entry.hash:  # it may come before its place in the journal is known
            row.message = _to_json_dict(entry)
        return
    session.add(
        AuditRow(
            key=key,
            at_ms=parse_iso_ms(entry.at),
            kind=entry.kind.value,
            text=_replace_nul(entry.text),
            by=_replace_nul(entry.by),
            message=_to_json_dict(entry),
        )
    )
    for name in RECORD_FIELDS:
        if about := getattr(entry, name):
            ingest(session, about)


def _ingest_file_record(session: Session, record: FileRecord) -> None:
    row = _get_row(session, FileRow, record.name)
    if row is None:
        row = FileRow(name=record.name)
        session.add(row)
    row.run_id, row.size_bytes = record.run_id, record.size_bytes
    row.made_ms, row.duration_s = parse_iso_ms(record.made_at), record.duration_s
    row.samples, row.lost_samples = record.samples, record.lost_samples
    row.condition = record.condition.value if record.condition else None
    row.deleted_ms = parse_iso_ms(record.deleted_at) if record.deleted_at else None
    row.deleted_by = _replace_nul(record.deleted_by)
    row.message = _to_json_dict(record)
