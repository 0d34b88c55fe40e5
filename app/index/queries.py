"""Classes of queries of the index, with filters and paging as REST takes them, and functions for their SQL."""

from datetime import datetime
from enum import StrEnum
from typing import Annotated

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field
from sqlalchemy import ColumnElement, Connection, Select, and_, func, or_, select
from sqlalchemy.orm import InstrumentedAttribute

from app.index.tables import AlarmRow, AuditRow, FileRow, GraspRow, LabSessionRow, RunRow
from app.messages.alarms import AlarmKind
from app.messages.journal import JournalKind
from app.messages.runs import RunState
from estimator.force_alarms import Priority

SearchText = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00]*$")]


class SortOrder(StrEnum):
    OLDEST = "oldest"
    NEWEST = "newest"


class TimeRangeQuery(BaseModel):
    """Filters by time and offset; null means any."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    offset: Annotated[int, Field(ge=0, le=1_000_000_000, description="Number of results to skip")] = 0
    since: Annotated[AwareDatetime | None, Field(description="Earliest time, ISO 8601 with a time zone")] = None
    until: Annotated[
        AwareDatetime | None, Field(description="Time before which to search, ISO 8601 with a time zone")
    ] = None


class PageQuery(TimeRangeQuery):
    """Query for one page."""

    limit: Annotated[int, Field(ge=1, le=500, description="Maximum number of results")] = 100
    order: Annotated[SortOrder, Field(description="Order of the results")] = SortOrder.NEWEST


class RecordingQuery(TimeRangeQuery):
    """Query of the recordings folder; `since` and `until` refer to when a recording was made."""

    limit: Annotated[int | None, Field(ge=1, le=500, description="Maximum number of results; null: all")] = None
    q: Annotated[
        SearchText | None, Field(description="Words in its name, protocol, people, tissues, answers or what was held")
    ] = None


class RunQuery(PageQuery):
    order: SortOrder = SortOrder.OLDEST
    state: RunState | None = None
    protocol: SearchText | None = None
    tissue: Annotated[SearchText | None, Field(description="Tissue stated at its start")] = None
    label: Annotated[SearchText | None, Field(description="Label of one of its grasps")] = None
    by: SearchText | None = None
    session: Annotated[SearchText | None, Field(description="Laboratory session that it belongs to")] = None
    q: Annotated[SearchText | None, Field(description="Text in its id, protocol, tissue, operator or reason")] = None


class GraspQuery(PageQuery):
    """Query of grasps; `since` and `until` refer to the run's start."""

    label: SearchText | None = None
    tissue: Annotated[SearchText | None, Field(description="Tissue stated for its run")] = None
    valid: bool | None = None
    run: SearchText | None = None


class AlarmQuery(PageQuery):
    kind: AlarmKind | None = None
    priority: Priority | None = None
    run: Annotated[SearchText | None, Field(description="Run during which it was on")] = None
    q: Annotated[SearchText | None, Field(description="Text in its message")] = None


class AuditQuery(PageQuery):
    kind: JournalKind | None = None
    by: SearchText | None = None
    q: Annotated[SearchText | None, Field(description="Text in its message")] = None


class LabSessionQuery(PageQuery):
    subject: SearchText | None = None
    q: Annotated[SearchText | None, Field(description="Text in its id, subject or species")] = None


class FileQuery(PageQuery):
    run: SearchText | None = None
    deleted: bool | None = None
    q: Annotated[SearchText | None, Field(description="Text in its name")] = None


def select_runs(query: RunQuery) -> Select[tuple[RunRow]]:
    """Select runs, without those known only by their grasps."""
    named = select(GraspRow.run_id).where(GraspRow.run_id == RunRow.id, GraspRow.label == query.label)
    statement = select(RunRow).where(
        RunRow.state.is_not(None),
        *_match_equal((RunRow.state, query.state), (RunRow.protocol, query.protocol), (RunRow.tissue, query.tissue)),
        *_match_equal((RunRow.by, query.by), (RunRow.session, query.session)),
        *_match_time_range(RunRow.started_ms, query),
        *_match_text(query.q, RunRow.id, RunRow.protocol, RunRow.tissue, RunRow.by, RunRow.why),
    )
    if query.label is not None:
        statement = statement.where(named.exists())
    return _order_by(statement, query.order, RunRow.started_ms, RunRow.id)


def select_grasps(query: GraspQuery) -> Select[tuple[GraspRow]]:
    statement = (
        select(GraspRow)
        .join(RunRow, RunRow.id == GraspRow.run_id)
        .where(
            *_match_equal((GraspRow.label, query.label), (RunRow.tissue, query.tissue), (GraspRow.valid, query.valid)),
            *_match_equal((GraspRow.run_id, query.run)),
            *_match_time_range(RunRow.started_ms, query),
        )
    )
    return _order_by(statement, query.order, func.coalesce(RunRow.started_ms, 0.0), GraspRow.run_id, GraspRow.index)


def select_alarms(query: AlarmQuery) -> Select[tuple[AlarmRow]]:
    statement = select(AlarmRow).where(
        *_match_equal((AlarmRow.kind, query.kind), (AlarmRow.priority, query.priority)),
        *_match_time_range(AlarmRow.began_ms, query),
        *_match_text(query.q, AlarmRow.text),
    )
    if query.run is not None:
        meanwhile = and_(
            RunRow.id == query.run,
            or_(AlarmRow.ended_ms.is_(None), AlarmRow.ended_ms >= RunRow.started_ms),
            or_(RunRow.ended_ms.is_(None), AlarmRow.began_ms <= RunRow.ended_ms),
        )
        statement = statement.where(select(RunRow.id).where(meanwhile).exists())
    return _order_by(statement, query.order, AlarmRow.began_ms, AlarmRow.key)


def select_journal_lines(query: AuditQuery) -> Select[tuple[AuditRow]]:
    statement = select(AuditRow).where(
        *_match_equal((AuditRow.kind, query.kind), (AuditRow.by, query.by)),
        *_match_time_range(AuditRow.at_ms, query),
        *_match_text(query.q, AuditRow.text),
    )
    return _order_by(statement, query.order, AuditRow.at_ms, AuditRow.key)


ChainPosition = tuple[str, int, str, str]
"""A line's chain, its number there, its hash and its text."""


def fetch_chain_positions(connection: Connection) -> list[ChainPosition]:
    """Return the positions of all lines that have a place in the journal's chain."""
    message = AuditRow.message
    own = message["hash"].as_string()
    statement = select(message["chain"].as_string(), message["number"].as_integer(), own, AuditRow.text)
    return [row.tuple() for row in connection.execute(statement.where(own.is_not(None)))]


def select_lab_sessions(query: LabSessionQuery) -> Select[tuple[LabSessionRow]]:
    statement = select(LabSessionRow).where(
        *_match_equal((LabSessionRow.subject, query.subject)),
        *_match_time_range(LabSessionRow.began_ms, query),
        *_match_text(query.q, LabSessionRow.id, LabSessionRow.subject, LabSessionRow.species),
    )
    return _order_by(statement, query.order, LabSessionRow.began_ms, LabSessionRow.id)


def select_files(query: FileQuery) -> Select[tuple[FileRow]]:
    statement = select(FileRow).where(
        *_match_equal((FileRow.run_id, query.run)),
        *_match_time_range(FileRow.made_ms, query),
        *_match_text(query.q, FileRow.name),
    )
    if query.deleted is not None:
        statement = statement.where(FileRow.deleted_ms.is_not(None) if query.deleted else FileRow.deleted_ms.is_(None))
    return _order_by(statement, query.order, FileRow.made_ms, FileRow.name)


def _match_equal(*pairs: tuple[InstrumentedAttribute, object]) -> list[ColumnElement[bool]]:
    return [column == value for column, value in pairs if value is not None]


def _match_time_range(column: InstrumentedAttribute, query: PageQuery) -> list[ColumnElement[bool]]:
    bounds: list[ColumnElement[bool]] = []
    if query.since is not None:
        bounds.append(column >= _to_ms(query.since))
    if query.until is not None:
        bounds.append(column < _to_ms(query.until))
    return bounds


def _to_ms(moment: datetime) -> float:
    return moment.timestamp() * 1e3


def _match_text(words: str | None, *columns: InstrumentedAttribute) -> list[ColumnElement[bool]]:
    return [] if words is None else [or_(*(column.icontains(words, autoescape=True) for column in columns))]


def _order_by(statement: Select, order: SortOrder, *columns: ColumnElement | InstrumentedAttribute) -> Select:
    return statement.order_by(*(column.desc() if order is SortOrder.NEWEST else column.asc() for column in columns))
