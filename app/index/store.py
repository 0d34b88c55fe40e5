"""The class Store, which puts records into the index and finds them. It blocks; IndexWriter is for the event loop."""

import contextlib
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from sqlalchemy import URL, ColumnElement, Select, func, select, true
from sqlalchemy.exc import DBAPIError, IntegrityError
from sqlalchemy.orm import InstrumentedAttribute, Session

from app.index import queries
from app.index.database import explain_database_errors, make_engine, make_writing_engine, migrate
from app.index.database_errors import is_write_conflict
from app.index.index_lock import IndexLock
from app.index.ingest import IndexedMessage, ingest, line_key
from app.index.queries import AlarmQuery, AuditQuery, FileQuery, GraspQuery, LabSessionQuery, PageQuery, RunQuery
from app.index.tables import AuditRow, FileRow, GraspRow, IndexTable, LabSessionRow, MarkRow, RunRow, TruthRow
from app.messages.alarms import Alarm
from app.messages.annotations import GraspTruth, Mark
from app.messages.grasps import Grasp, GraspEnded
from app.messages.journal import JournalEntry
from app.messages.lab_sessions import LabSession
from app.messages.recordings import FileRecord
from app.messages.runs import Run, RunState
from app.messages.stored import read_stored

MAX_IDS_IN_QUERY = 500  # of more runs, all are read
MAX_TRIES = 5  # while another writer is faster
M = TypeVar("M")
RowT = TypeVar("RowT", RunRow, FileRow, MarkRow, LabSessionRow)


@dataclass(frozen=True, slots=True)
class Page(Generic[M]):
    """One page of results, and the number of all."""

    items: list[M]
    total: int


@dataclass(slots=True)
class RunSummary:
    """What a list shows of a run: subject, answers of its grasps in order, and what people say was held, each once."""

    subject: str | None = None
    labels: list[str] = field(default_factory=list)
    held: list[str] = field(default_factory=list)


class Store:
    """An open, migrated index, locked for a service or, with `exclusive`, for a rebuild; for several threads.

    Raises:
        ConfigurationError: PostgreSQL's driver is missing.
        ServiceError: it cannot be opened; the text says why and what to do next.
    """

    def __init__(self, url: URL, *, exclusive: bool = False) -> None:
        self.url = url
        self._engine = make_engine(url)
        self._index_lock = IndexLock(self._engine, exclusive=exclusive)
        try:
            migrate(self._engine)
            if not exclusive:
                self._index_lock.downgrade_to_shared()
        except BaseException:
            self.close()
            raise

    @property
    def had_no_other_user(self) -> bool:
        """Whether no other service used the index when this one opened it."""
        return self._index_lock.had_no_other_user

    def close(self) -> None:
        self._index_lock.close()
        self._engine.dispose()

    # --- write -------------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def write_transaction(self) -> Iterator[Session]:
        """Open a transaction: all of it is written, or nothing."""
        with Session(make_writing_engine(self._engine)) as session, session.begin():
            yield session

    def ingest(self, message: IndexedMessage, run_id: str | None = None) -> None:
        """Put a record into the index; a second time changes nothing. `run_id`: of a grasp without one.

        Raises:
            DBAPIError: it could not be written.
        """
        self.ingest_all([(message, run_id)])

    def ingest_all(self, messages: Iterable[tuple[IndexedMessage, str | None]]) -> None:
        """Put many messages into the index, all or none."""
        messages = list(messages)
        for left in reversed(range(MAX_TRIES)):
            try:
                with self.write_transaction() as session:
                    for message, run_id in messages:
                        ingest(session, message, run_id)
            except DBAPIError as error:
                if not left or not (is_write_conflict(error) or isinstance(error, IntegrityError)):
                    raise
            else:
                return

    def ingest_new_lines(self, entries: list[JournalEntry]) -> None:
        """Ingest the journal lines that the index lacks."""
        keys = {line_key(entry): entry for entry in entries}
        with Session(self._engine) as session:
            known = set(session.scalars(select(AuditRow.key).where(AuditRow.key.in_(keys))))
        self.ingest_all((entry, None) for key, entry in keys.items() if key not in known)

    # --- read --------------------------------------------------------------------------------------------------------

    def find_runs(self, query: RunQuery) -> Page[Run]:
        rows, total = self._fetch_page(queries.select_runs(query), query)
        return Page([_to_run(row) for row in rows], total)

    def get_run(self, run_id: str) -> Run | None:
        row = self._get_row(RunRow, run_id)
        return _to_run(row) if row and row.message is not None else None

    def find_unfinished_runs(self) -> list[Run]:
        """Return the runs whose last known state is under way."""
        with explain_database_errors(self.url), Session(self._engine) as session:
            query = select(RunRow).where(RunRow.state == RunState.RUNNING.value).order_by(RunRow.started_ms)
            return [_to_run(row) for row in session.scalars(query)]

    def find_grasps(self, query: GraspQuery) -> Page[GraspEnded]:
        rows, total = self._fetch_page(queries.select_grasps(query), query)
        return Page([read_stored(GraspEnded, row.message) for row in rows], total)

    def list_run_grasps(self, run_id: str) -> list[Grasp]:
        """Return all grasps of a run, in order."""
        with explain_database_errors(self.url), Session(self._engine) as session:
            rows = session.scalars(select(GraspRow).where(GraspRow.run_id == run_id).order_by(GraspRow.index))
            return [read_stored(GraspEnded, row.message).grasp for row in rows]

    def list_run_truths(self, run_id: str) -> list[GraspTruth]:
        """Return the stated ground truth of a run's grasps, in order."""
        if "\0" in run_id:
            return []  # no name has a NUL, and PostgreSQL refuses it in a query
        with explain_database_errors(self.url), Session(self._engine) as session:
            rows = session.scalars(select(TruthRow).where(TruthRow.run_id == run_id).order_by(TruthRow.grasp))
            return [read_stored(GraspTruth, row.message) for row in rows]

    def summarize_runs(self, run_ids: Collection[str]) -> dict[str, RunSummary]:
        """Return subject, answers and stated tissues by run, at least of these runs."""

        def is_listed(column: InstrumentedAttribute[str]) -> ColumnElement[bool]:
            return column.in_(run_ids) if len(run_ids) <= MAX_IDS_IN_QUERY else true()

        grasps = select(GraspRow.run_id, GraspRow.label).where(is_listed(GraspRow.run_id))
        grasps = grasps.order_by(GraspRow.run_id, GraspRow.index)
        truths = select(TruthRow.run_id, TruthRow.held, TruthRow.remark).where(is_listed(TruthRow.run_id))
        truths = truths.order_by(TruthRow.run_id, TruthRow.grasp)
        subjects = select(RunRow.id, LabSessionRow.subject).join(LabSessionRow, LabSessionRow.id == RunRow.session)
        subjects = subjects.where(is_listed(RunRow.id))
        found: defaultdict[str, RunSummary] = defaultdict(RunSummary)
        with explain_database_errors(self.url), self._engine.connect() as connection:
            for run_id, label in connection.execute(grasps):
                found[run_id].labels.append(label)
            for run_id, *stated in connection.execute(truths):
                held = found[run_id].held
                held += [each for each in stated if each and each not in held]
            for run_id, subject in connection.execute(subjects):
                found[run_id].subject = subject
        return dict(found)

    def list_truths(self) -> list[GraspTruth]:
        """Return the stated ground truth of all runs."""
        with explain_database_errors(self.url), Session(self._engine) as session:
            return [read_stored(GraspTruth, row.message) for row in session.scalars(select(TruthRow))]

    def list_run_marks(self, run_id: str) -> list[Mark]:
        """Return the marks of a run by their time, without deleted ones."""
        if "\0" in run_id:
            return []
        query = select(MarkRow).where(MarkRow.run_id == run_id, MarkRow.deleted.is_(False))
        with explain_database_errors(self.url), Session(self._engine) as session:
            return [read_stored(Mark, row.message) for row in session.scalars(query.order_by(MarkRow.at_s, MarkRow.id))]

    def get_mark(self, mark_id: str) -> Mark | None:
        row = self._get_row(MarkRow, mark_id)
        return read_stored(Mark, row.message) if row else None

    def find_lab_sessions(self, query: LabSessionQuery) -> Page[LabSession]:
        rows, total = self._fetch_page(queries.select_lab_sessions(query), query)
        return Page([read_stored(LabSession, row.message) for row in rows], total)

    def list_lab_sessions(self) -> list[LabSession]:
        """Return all laboratory sessions."""
        with explain_database_errors(self.url), Session(self._engine) as session:
            return [read_stored(LabSession, row.message) for row in session.scalars(select(LabSessionRow))]

    def get_lab_session(self, session_id: str) -> LabSession | None:
        row = self._get_row(LabSessionRow, session_id)
        return read_stored(LabSession, row.message) if row else None

    def find_lab_session_under_way(self) -> LabSession | None:
        """Return the laboratory session that nobody has ended, the newest if there are several."""
        query = select(LabSessionRow).where(LabSessionRow.ended_ms.is_(None)).order_by(LabSessionRow.began_ms.desc())
        with explain_database_errors(self.url), Session(self._engine) as session:
            row = session.scalars(query).first()
            return read_stored(LabSession, row.message) if row else None

    def find_alarms(self, query: AlarmQuery) -> Page[Alarm]:
        rows, total = self._fetch_page(queries.select_alarms(query), query)
        return Page([read_stored(Alarm, row.message) for row in rows], total)

    def find_audit_entries(self, query: AuditQuery) -> Page[JournalEntry]:
        rows, total = self._fetch_page(queries.select_journal_lines(query), query)
        return Page([read_stored(JournalEntry, row.message) for row in rows], total)

    def list_chain_positions(self) -> list[queries.ChainPosition]:
        """Return the positions of all lines that have a place in the journal's chain."""
        with explain_database_errors(self.url), self._engine.connect() as connection:
            return queries.fetch_chain_positions(connection)

    def find_files(self, query: FileQuery) -> Page[FileRecord]:
        rows, total = self._fetch_page(queries.select_files(query), query)
        return Page([read_stored(FileRecord, row.message) for row in rows], total)

    def get_file(self, name: str) -> FileRecord | None:
        row = self._get_row(FileRow, name)
        return read_stored(FileRecord, row.message) if row else None

    def list_file_names(self) -> set[str]:
        with explain_database_errors(self.url), Session(self._engine) as session:
            return set(session.scalars(select(FileRow.name)))

    def dump(self) -> dict[str, list[dict[str, object]]]:
        """Return all rows, sorted: two indexes are equal if their dumps are."""
        with explain_database_errors(self.url), self._engine.connect() as connection:
            return {
                name: [dict(row) for row in connection.execute(table.select().order_by(*table.primary_key)).mappings()]
                for name, table in IndexTable.metadata.tables.items()
            }

    def _get_row(self, table: type[RowT], key: str) -> RowT | None:
        if "\0" in key:
            return None  # no name has a NUL, and PostgreSQL refuses it in a query
        with explain_database_errors(self.url), Session(self._engine) as session:
            return session.get(table, key)

    def _fetch_page(self, statement: Select, query: PageQuery) -> tuple[list, int]:
        with explain_database_errors(self.url), Session(self._engine) as session:
            total = session.scalar(select(func.count()).select_from(statement.order_by(None).subquery()))
            return list(session.scalars(statement.limit(query.limit).offset(query.offset))), total or 0


def _to_run(row: RunRow) -> Run:
    return read_stored(Run, {**(row.message or {}), "grasps": row.grasps})
