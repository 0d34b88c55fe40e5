"""The index: takes wire messages, answers questions with wire messages. Blocks; see keeper.py for the event loop."""

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from sqlalchemy import URL, Select, func, select
from sqlalchemy.exc import DBAPIError, IntegrityError
from sqlalchemy.orm import Session

from app.store import questions
from app.store.claim import Claim
from app.store.database import bring_up_to_date, engine_of, faults_explained, writing
from app.store.faults import lost_race
from app.store.questions import AlarmQuestion, AuditQuestion, FileQuestion, GraspQuestion, Question, RunQuestion
from app.store.tables import AuditRow, FileRow, GraspRow, RunRow, Table
from app.store.taking import Indexed, line_key, take
from app.wire import Alarm, FileRecord, Grasp, GraspEnded, JournalEntry, Run, RunState

TRIES = 5  # against another writer who is quicker
M = TypeVar("M")


@dataclass(frozen=True, slots=True)
class Found(Generic[M]):
    """One page, and how many there are on all."""

    items: list[M]
    total: int


class Store:
    """An open index, up to date and claimed for a service, or for a rebuild `alone`. May be used from several threads.

    Raises:
        ConfigurationError: PostgreSQL's driver is missing.
        ServiceError: it cannot be opened; the text says why and what to do next.
    """

    def __init__(self, url: URL, *, alone: bool = False) -> None:
        self.url = url
        self._engine = engine_of(url)
        self._claim = Claim(self._engine, alone=alone)
        try:
            bring_up_to_date(self._engine)
            if not alone:
                self._claim.share()
        except BaseException:
            self.close()
            raise

    @property
    def first(self) -> bool:
        """Whether no other service used it when this one came."""
        return self._claim.first

    def close(self) -> None:
        self._claim.close()
        self._engine.dispose()

    # --- take --------------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def writing(self) -> Iterator[Session]:
        """A transaction: all of it is written, or nothing."""
        with Session(writing(self._engine)) as session, session.begin():
            yield session

    def take(self, message: Indexed, run_id: str | None = None) -> None:
        """Put a wire message into the index; the same twice changes nothing. `run_id`: of a grasp that says none.

        Raises:
            DBAPIError: it could not be written.
        """
        self.take_all([(message, run_id)])

    def take_all(self, messages: Iterable[tuple[Indexed, str | None]]) -> None:
        """The same for many at once: all or none."""
        messages = list(messages)
        for left in reversed(range(TRIES)):
            try:
                with self.writing() as session:
                    for message, run_id in messages:
                        take(session, message, run_id)
                return
            except DBAPIError as error:
                if not left or not (lost_race(error) or isinstance(error, IntegrityError)):
                    raise

    def take_new_lines(self, entries: list[JournalEntry]) -> None:
        """Those lines of the journal that are not there yet."""
        keys = {line_key(entry): entry for entry in entries}
        with Session(self._engine) as session:
            known = set(session.scalars(select(AuditRow.key).where(AuditRow.key.in_(keys))))
        self.take_all((entry, None) for key, entry in keys.items() if key not in known)

    # --- ask ---------------------------------------------------------------------------------------------------------

    def runs(self, asked: RunQuestion) -> Found[Run]:
        rows, total = self._page(questions.runs(asked), asked)
        return Found([_run(row) for row in rows], total)

    def run(self, run_id: str) -> Run | None:
        row = self._one(RunRow, run_id)
        return _run(row) if row and row.message is not None else None

    def cut_short(self) -> list[Run]:
        """Runs that are said to be under way."""
        with faults_explained(self.url), Session(self._engine) as session:
            query = select(RunRow).where(RunRow.state == RunState.RUNNING.value).order_by(RunRow.started_ms)
            return [_run(row) for row in session.scalars(query)]

    def grasps(self, asked: GraspQuestion) -> Found[GraspEnded]:
        rows, total = self._page(questions.grasps(asked), asked)
        return Found([GraspEnded.model_validate(row.message) for row in rows], total)

    def grasps_of(self, run_id: str) -> list[Grasp]:
        """All of a run, in order."""
        with faults_explained(self.url), Session(self._engine) as session:
            rows = session.scalars(select(GraspRow).where(GraspRow.run_id == run_id).order_by(GraspRow.index))
            return [GraspEnded.model_validate(row.message).grasp for row in rows]

    def alarms(self, asked: AlarmQuestion) -> Found[Alarm]:
        rows, total = self._page(questions.alarms(asked), asked)
        return Found([Alarm.model_validate(row.message) for row in rows], total)

    def audit(self, asked: AuditQuestion) -> Found[JournalEntry]:
        rows, total = self._page(questions.audit(asked), asked)
        return Found([JournalEntry.model_validate(row.message) for row in rows], total)

    def chained(self) -> list[questions.Place]:
        """Every line that has its place in the journal's chain."""
        with faults_explained(self.url), self._engine.connect() as connection:
            return questions.chained(connection)

    def files(self, asked: FileQuestion) -> Found[FileRecord]:
        rows, total = self._page(questions.files(asked), asked)
        return Found([FileRecord.model_validate(row.message) for row in rows], total)

    def file(self, name: str) -> FileRecord | None:
        row = self._one(FileRow, name)
        return FileRecord.model_validate(row.message) if row else None

    def file_names(self) -> set[str]:
        with faults_explained(self.url), Session(self._engine) as session:
            return set(session.scalars(select(FileRow.name)))

    def content(self) -> dict[str, list[dict[str, object]]]:
        """Everything, sorted: two indexes are equal if this is."""
        with faults_explained(self.url), self._engine.connect() as connection:
            return {
                name: [dict(row) for row in connection.execute(table.select().order_by(*table.primary_key)).mappings()]
                for name, table in Table.metadata.tables.items()
            }

    def _one(self, table: type[RunRow] | type[FileRow], key: str) -> RunRow | FileRow | None:
        if "\0" in key:
            return None  # nothing is called so, and PostgreSQL does not even take the question
        with faults_explained(self.url), Session(self._engine) as session:
            return session.get(table, key)

    def _page(self, query: Select, asked: Question) -> tuple[list, int]:
        with faults_explained(self.url), Session(self._engine) as session:
            total = session.scalar(select(func.count()).select_from(query.order_by(None).subquery()))
            return list(session.scalars(query.limit(asked.limit).offset(asked.offset))), total or 0


def _run(row: RunRow) -> Run:
    return Run.model_validate({**(row.message or {}), "grasps": row.grasps})
