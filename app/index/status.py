"""Functions that read an index's status, its counts and what it lacks, without changing it."""

from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import URL, Connection, MetaData, Table, inspect, select
from sqlalchemy import func as sql

from app.index import queries
from app.index.database import explain_database_errors, make_reading_engine, newest_revision, read_revision
from app.index.database_errors import display_url
from app.index.ingest import line_key
from app.index.queries import ChainPosition
from app.index.rebuild import BEHIND_MARKER_FILE, RecordingReader, find_recordings, parse_journal_lines
from app.index.tables import IndexTable as Ours

MAX_TAIL_BYTES = 100_000  # of the journal: enough for its last line


@dataclass(frozen=True, slots=True)
class IndexStatus:
    """Status of an index. `counts` is empty if there is none; `behind` lists what it lacks."""

    where: str
    revision: str | None
    newest_revision: str
    counts: dict[str, int]
    behind: list[str]


def read_status(url: URL, data: Path, readers: tuple[RecordingReader, ...]) -> IndexStatus:
    """Read the status of an index.

    Raises:
        ConfigurationError: PostgreSQL's driver is missing.
        ServiceError: it cannot be read.
    """
    if url.get_backend_name() == "sqlite" and not Path(url.database or "").exists():  # a look must not create one
        lacks = "there is no index yet" if data.is_dir() else f"there is no folder {data}"
        return IndexStatus(display_url(url), None, newest_revision(), {}, [f"everything: {lacks}"])
    engine = make_reading_engine(url)
    try:
        with explain_database_errors(url), engine.connect() as connection:
            revision = read_revision(connection)
            there = set(inspect(connection).get_table_names()) & set(Ours.metadata.tables) if revision else set()
            tables = {name: Table(name, MetaData(), autoload_with=connection) for name in sorted(there)}
            counts = {
                name: connection.execute(select(sql.count()).select_from(table)).scalar_one()
                for name, table in tables.items()
            }
            behind = _find_missing(connection, tables, data, readers) if tables else ["everything: it is empty"]
    finally:
        engine.dispose()
    return IndexStatus(display_url(url), revision, newest_revision(), counts, behind)


def read_chain_positions(url: URL) -> list[ChainPosition]:
    """Return the positions in the journal's chain that the index holds; none if there is no index yet.

    Raises:
        ConfigurationError: PostgreSQL's driver is missing.
        ServiceError: it cannot be read.
    """
    if url.get_backend_name() == "sqlite" and not Path(url.database or "").exists():  # a look must not create one
        return []
    engine = make_reading_engine(url)
    try:
        with explain_database_errors(url), engine.connect() as connection:
            return queries.fetch_chain_positions(connection) if inspect(connection).has_table("audit") else []
    finally:
        engine.dispose()


def _find_missing(
    connection: Connection, tables: dict[str, Table], data: Path, readers: tuple[RecordingReader, ...]
) -> list[str]:
    found = ["what there was no room for while it could not be written"] if (data / BEHIND_MARKER_FILE).exists() else []
    names = set(connection.scalars(select(tables["files"].c.name)))
    missing = [path.name for path in find_recordings(data, readers) if path.name not in names]
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
            file.seek(max(path.stat().st_size - MAX_TAIL_BYTES, 0))
            entries = [entry for entry in parse_journal_lines(file) if entry]
    except OSError:
        return None
    return line_key(entries[-1]) if entries else None
