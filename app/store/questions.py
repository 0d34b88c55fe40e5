"""What can be asked of the index: filters and paging, as REST takes them, and the queries they become."""

from datetime import datetime
from enum import StrEnum
from typing import Annotated

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field
from sqlalchemy import ColumnElement, Connection, Select, and_, func, or_, select
from sqlalchemy.orm import InstrumentedAttribute

from app.store.tables import AlarmRow, AuditRow, FileRow, GraspRow, RunRow
from app.wire import AlarmKind, JournalKind, Priority, RunState

Words = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00]*$")]


class Order(StrEnum):
    OLDEST = "oldest"
    NEWEST = "newest"


class Span(BaseModel):
    """Null: any."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    offset: Annotated[int, Field(ge=0, le=1_000_000_000, description="Leave out so many before them")] = 0
    since: Annotated[AwareDatetime | None, Field(description="ISO 8601 with a zone; from then on")] = None
    until: Annotated[AwareDatetime | None, Field(description="ISO 8601 with a zone; before then")] = None


class Question(Span):
    """One page of what was asked for."""

    limit: Annotated[int, Field(ge=1, le=500, description="At most so many")] = 100
    order: Annotated[Order, Field(description="Which come first")] = Order.NEWEST


class RecordingQuestion(Span):
    """Of the recordings folder, which is no part of the index; times are of the last change."""

    limit: Annotated[int | None, Field(ge=1, le=500, description="At most so many; null: all")] = None
    q: Annotated[Words | None, Field(description="In its name")] = None


class RunQuestion(Question):
    order: Order = Order.OLDEST
    state: RunState | None = None
    protocol: Words | None = None
    tissue: Annotated[Words | None, Field(description="What it was said to hold")] = None
    label: Annotated[Words | None, Field(description="What one of its grasps was named")] = None
    by: Words | None = None
    q: Annotated[Words | None, Field(description="In its id, protocol, tissue, who or why")] = None


class GraspQuestion(Question):
    """`since` and `until` are of the run's start."""

    label: Words | None = None
    tissue: Annotated[Words | None, Field(description="What its run was said to hold")] = None
    valid: bool | None = None
    run: Words | None = None


class AlarmQuestion(Question):
    kind: AlarmKind | None = None
    priority: Priority | None = None
    run: Annotated[Words | None, Field(description="On while this run was under way")] = None
    q: Annotated[Words | None, Field(description="In its text")] = None


class AuditQuestion(Question):
    kind: JournalKind | None = None
    by: Words | None = None
    q: Annotated[Words | None, Field(description="In its text")] = None


class FileQuestion(Question):
    run: Words | None = None
    deleted: bool | None = None
    q: Annotated[Words | None, Field(description="In its name")] = None


def runs(asked: RunQuestion) -> Select[tuple[RunRow]]:
    """Without those that only their grasps are known of."""
    named = select(GraspRow.run_id).where(GraspRow.run_id == RunRow.id, GraspRow.label == asked.label)
    query = select(RunRow).where(
        RunRow.state.is_not(None),
        *_equal((RunRow.state, asked.state), (RunRow.protocol, asked.protocol), (RunRow.tissue, asked.tissue)),
        *_equal((RunRow.by, asked.by)),
        *_within(RunRow.started_ms, asked),
        *_containing(asked.q, RunRow.id, RunRow.protocol, RunRow.tissue, RunRow.by, RunRow.why),
    )
    if asked.label is not None:
        query = query.where(named.exists())
    return _sorted(query, asked.order, RunRow.started_ms, RunRow.id)


def grasps(asked: GraspQuestion) -> Select[tuple[GraspRow]]:
    query = (
        select(GraspRow)
        .join(RunRow, RunRow.id == GraspRow.run_id)
        .where(
            *_equal((GraspRow.label, asked.label), (RunRow.tissue, asked.tissue), (GraspRow.valid, asked.valid)),
            *_equal((GraspRow.run_id, asked.run)),
            *_within(RunRow.started_ms, asked),
        )
    )
    return _sorted(query, asked.order, func.coalesce(RunRow.started_ms, 0.0), GraspRow.run_id, GraspRow.index)


def alarms(asked: AlarmQuestion) -> Select[tuple[AlarmRow]]:
    query = select(AlarmRow).where(
        *_equal((AlarmRow.kind, asked.kind), (AlarmRow.priority, asked.priority)),
        *_within(AlarmRow.began_ms, asked),
        *_containing(asked.q, AlarmRow.text),
    )
    if asked.run is not None:
        meanwhile = and_(
            RunRow.id == asked.run,
            or_(AlarmRow.ended_ms.is_(None), AlarmRow.ended_ms >= RunRow.started_ms),
            or_(RunRow.ended_ms.is_(None), AlarmRow.began_ms <= RunRow.ended_ms),
        )
        query = query.where(select(RunRow.id).where(meanwhile).exists())
    return _sorted(query, asked.order, AlarmRow.began_ms, AlarmRow.key)


def audit(asked: AuditQuestion) -> Select[tuple[AuditRow]]:
    query = select(AuditRow).where(
        *_equal((AuditRow.kind, asked.kind), (AuditRow.by, asked.by)),
        *_within(AuditRow.at_ms, asked),
        *_containing(asked.q, AuditRow.text),
    )
    return _sorted(query, asked.order, AuditRow.at_ms, AuditRow.key)


Place = tuple[str, int, str, str]
"""A line's chain, its number there, its hash and its text."""


def chained(connection: Connection) -> list[Place]:
    """Of every line that has its place in the journal's chain."""
    message = AuditRow.message
    own = message["hash"].as_string()
    query = select(message["chain"].as_string(), message["number"].as_integer(), own, AuditRow.text)
    return [row.tuple() for row in connection.execute(query.where(own.is_not(None)))]


def files(asked: FileQuestion) -> Select[tuple[FileRow]]:
    query = select(FileRow).where(
        *_equal((FileRow.run_id, asked.run)), *_within(FileRow.made_ms, asked), *_containing(asked.q, FileRow.name)
    )
    if asked.deleted is not None:
        query = query.where(FileRow.deleted_ms.is_not(None) if asked.deleted else FileRow.deleted_ms.is_(None))
    return _sorted(query, asked.order, FileRow.made_ms, FileRow.name)


def _equal(*pairs: tuple[InstrumentedAttribute, object]) -> list[ColumnElement[bool]]:
    return [column == value for column, value in pairs if value is not None]


def _within(column: InstrumentedAttribute, asked: Question) -> list[ColumnElement[bool]]:
    bounds: list[ColumnElement[bool]] = []
    if asked.since is not None:
        bounds.append(column >= _milliseconds(asked.since))
    if asked.until is not None:
        bounds.append(column < _milliseconds(asked.until))
    return bounds


def _milliseconds(moment: datetime) -> float:
    return moment.timestamp() * 1e3


def _containing(words: str | None, *columns: InstrumentedAttribute) -> list[ColumnElement[bool]]:
    return [] if words is None else [or_(*(column.icontains(words, autoescape=True) for column in columns))]


def _sorted(query: Select, order: Order, *columns: ColumnElement | InstrumentedAttribute) -> Select:
    return query.order_by(*(column.desc() if order is Order.NEWEST else column.asc() for column in columns))
