"""What an index holds and whether it lacks something, without changing it."""

from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import URL, Connection, MetaData, Table, inspect, select
from sqlalchemy import func as sql

from app.store import questions
from app.store.database import engine_of, faults_explained, newest_revision, revision_of
from app.store.faults import shown
from app.store.questions import Place
from app.store.rebuild import BEHIND_MARKER, Reader, read_lines, recordings_in
from app.store.tables import Table as Ours
from app.store.taking import line_key

LAST_BYTES = 100_000  # of the journal: enough for its last line


@dataclass(frozen=True, slots=True)
class Status:
    """`counts` is empty where there is no index yet. `behind` says what it lacks; empty: nothing."""

    where: str
    revision: str | None
    newest_revision: str
    counts: dict[str, int]
    behind: list[str]


def status(url: URL, data: Path, readers: tuple[Reader, ...]) -> Status:
    """Look at an index.

    Raises:
        ConfigurationError: PostgreSQL's driver is missing.
        ServiceError: it cannot be read.
    """
    if url.get_backend_name() == "sqlite" and not Path(url.database or "").exists():  # looking must not make one
        return Status(shown(url), None, newest_revision(), {}, ["everything: there is no index yet"])
    engine = engine_of(url)
    try:
        with faults_explained(url), engine.connect() as connection:
            revision = revision_of(connection)
            there = set(inspect(connection).get_table_names()) & set(Ours.metadata.tables) if revision else set()
            tables = {name: Table(name, MetaData(), autoload_with=connection) for name in sorted(there)}
            counts = {name: connection.scalar(select(sql.count()).select_from(table)) for name, table in tables.items()}
            behind = _behind(connection, tables, data, readers) if tables else ["everything: it is empty"]
    finally:
        engine.dispose()
    return Status(shown(url), revision, newest_revision(), counts, behind)


def chained(url: URL) -> list[Place]:
    """What the index knows of the journal's chain; nothing where there is no index yet.

    Raises:
        ConfigurationError: PostgreSQL's driver is missing.
        ServiceError: it cannot be read.
    """
    if url.get_backend_name() == "sqlite" and not Path(url.database or "").exists():  # looking must not make one
        return []
    engine = engine_of(url)
    try:
        with faults_explained(url), engine.connect() as connection:
            return questions.chained(connection) if inspect(connection).has_table("audit") else []
    finally:
        engine.dispose()


def _behind(connection: Connection, tables: dict[str, Table], data: Path, readers: tuple[Reader, ...]) -> list[str]:
    found = ["what there was no room for while it could not be written"] if (data / BEHIND_MARKER).exists() else []
    names = set(connection.scalars(select(tables["files"].c.name)))
    missing = [path.name for path in recordings_in(data, readers) if path.name not in names]
    if missing:
        found.append(f"{len(missing)} of the recordings, such as {missing[0]}")
    key = _last_line_key(data / "journal.jsonl")
    audit = tables["audit"]
    if key and connection.scalar(select(audit.c.key).where(audit.c.key == key)) is None:
        found.append("the journal's last line")
    return found


def _last_line_key(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            file.seek(max(path.stat().st_size - LAST_BYTES, 0))
            entries = [entry for entry in read_lines(file) if entry]
    except OSError:
        return None
    return line_key(entries[-1]) if entries else None
