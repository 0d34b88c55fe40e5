"""Functions that connect to the index's database and migrate its tables, for SQLite and PostgreSQL."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import URL, Connection, Engine, create_engine, event, inspect, make_url, text
from sqlalchemy.exc import ArgumentError, DBAPIError

from app.index.database_errors import REBUILD_COMMAND, display_url, to_service_error
from app.index.tables import IndexTable
from config.errors import ConfigurationError, ServiceError
from config.home_folder import expand_home
from config.schema import Settings

MIGRATIONS_FOLDER = Path(__file__).parent / "migrations"
REVISION_TABLE = "graspwatch_revision"  # a PostgreSQL database may also have other programs' tables
LOCK_TIMEOUT_MS = 10_000
CONNECT_TIMEOUT_S = 5
MIGRATION_LOCK_ID = 0x67726173  # key of PostgreSQL's lock under which one service at a time migrates
# so that a lost server becomes an error: the default waits for a quarter of an hour
POSTGRESQL_CONNECT_ARGS = {
    "connect_timeout": CONNECT_TIMEOUT_S,
    "tcp_user_timeout": LOCK_TIMEOUT_MS,
    "options": f"-c statement_timeout={3 * LOCK_TIMEOUT_MS} -c lock_timeout={LOCK_TIMEOUT_MS}",
}


def resolve_index_url(setting: str | None, data: Path) -> URL:
    """Return the configured address of the index, else that of `index.sqlite` in the data folder.

    Raises:
        ConfigurationError: it is no address of SQLite or PostgreSQL.
    """
    if not setting:
        return URL.create("sqlite", database=str(data / "index.sqlite"))
    advice = "Write postgresql://user@host/database or sqlite:////folder/index.sqlite, or leave it out."
    try:
        url = make_url(setting)
    except (ArgumentError, ValueError):  # ValueError: a port that is no number
        raise ConfigurationError(f"index_url: is no address of a database. {advice}") from None
    match url.drivername:
        case "postgresql" | "postgres" | "postgresql+psycopg":
            return url.set(drivername="postgresql+psycopg")
        case "sqlite" if url.database and url.database != ":memory:" and not url.query:
            return url.set(database=os.path.abspath(expand_home(url.database)))
    raise ConfigurationError(f"index_url: {url.drivername!r} does not do as an index. {advice}")


def index_url_from_settings(settings: Settings, data: Path) -> URL:
    """Return the address of this data folder's index; raises as `resolve_index_url`."""
    return resolve_index_url(settings.index_url.get_secret_value() if settings.index_url else None, data)


def make_engine(url: URL) -> Engine:
    """Return an engine for the database, without connecting.

    Raises:
        ConfigurationError: PostgreSQL's driver is not installed.
    """
    if url.get_backend_name() != "sqlite":
        try:
            engine = create_engine(url, connect_args=POSTGRESQL_CONNECT_ARGS, pool_pre_ping=True, hide_parameters=True)
        except ImportError:
            raise ConfigurationError(
                "index_url names a PostgreSQL server, but its driver is missing. Run `pip install "
                "'graspwatch[postgresql]'`, or leave index_url out."
            ) from None
        return engine
    engine = create_engine(url, connect_args={"timeout": LOCK_TIMEOUT_MS / 1e3}, hide_parameters=True)
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def make_reading_engine(url: URL) -> Engine:
    """Return an engine that changes nothing, for a database that may be in a folder that cannot be written to.

    Raises:
        ConfigurationError: PostgreSQL's driver is not installed.
    """
    if url.get_backend_name() != "sqlite" or os.access(Path(url.database or "").parent, os.W_OK):
        return make_engine(url)
    # SQLite locks by files beside the database; where nobody can write, an empty log of writes needs none.
    log = Path(f"{url.database}-wal")
    how = {"mode": "ro"} if log.exists() and log.stat().st_size else {"immutable": "1"}
    return make_engine(url.set(database=f"file:{quote(url.database or '')}", query={"uri": "true", **how}))


def make_writing_engine(engine: Engine) -> Engine:
    """Return an engine for transactions that write; none silently overwrites another's change of a row."""
    if engine.dialect.name == "sqlite":
        return engine.execution_options(writes=True)
    return engine.execution_options(isolation_level="REPEATABLE READ")


def _prepare_sqlite(connection: Any, _: Any) -> None:
    connection.isolation_level = None  # transactions begin where `_begin_sqlite` says
    for pragma in ("foreign_keys=ON", f"busy_timeout={LOCK_TIMEOUT_MS}", "synchronous=NORMAL"):
        connection.execute(f"PRAGMA {pragma}").close()


def _begin_sqlite(connection: Connection) -> None:
    """Begin a transaction; a writing one waits for other writers now, because after a read it would be refused."""
    connection.exec_driver_sql("BEGIN IMMEDIATE" if connection.get_execution_options().get("writes") else "BEGIN")


@contextlib.contextmanager
def explain_database_errors(url: URL) -> Iterator[None]:
    """Convert database errors inside to a ServiceError that says what to do next."""
    try:
        yield
    except DBAPIError as error:
        raise to_service_error(url, error) from error


def migrate(engine: Engine) -> None:
    """Create the tables, or migrate those of an older index, in one transaction.

    Raises:
        ServiceError: the database is unreachable, damaged, read-only, of another program, or of a newer Graspwatch.
    """
    # PostgreSQL's usual isolation sees the tables that another service made while this one waited for the lock.
    migrating = make_writing_engine(engine) if engine.dialect.name == "sqlite" else engine
    with explain_database_errors(engine.url), migrating.begin() as connection:
        if engine.dialect.name == "postgresql":
            connection.execute(text(f"SELECT pg_advisory_xact_lock({MIGRATION_LOCK_ID})"))
        elif (damage := connection.exec_driver_sql("PRAGMA quick_check(1)").scalar_one()) != "ok":
            raise _unusable_index_error(engine.url, f"it is damaged ({damage.splitlines()[-1]})")
        revision = read_revision(connection)
        known = _list_revisions()
        if revision is None:
            _check_no_foreign_tables(engine, connection)
        elif revision not in known:
            raise _unusable_index_error(
                engine.url, f"a newer Graspwatch made it (revision {revision}; this one knows {known[0]})"
            )
        configuration = Config()
        configuration.set_main_option("script_location", str(MIGRATIONS_FOLDER).replace("%", "%%"))
        configuration.attributes.update(connection=connection, version_table=REVISION_TABLE)
        command.upgrade(configuration, "head")
        connection.execute(text(f"UPDATE {REVISION_TABLE} SET version_num = version_num"))  # fails if it is read-only
    if engine.dialect.name == "sqlite":
        _enable_write_ahead_log(engine)


def _enable_write_ahead_log(engine: Engine) -> None:
    """Let readers not wait for writers. The file stores this setting, so no other program's file must get it."""
    with explain_database_errors(engine.url), engine.connect() as connection:
        connection.connection.execute("PRAGMA journal_mode=WAL").close()  # SQLAlchemy would open a transaction


def read_revision(connection: Connection) -> str | None:
    """Return the revision of the tables, or None if there are none."""
    return MigrationContext.configure(connection, opts={"version_table": REVISION_TABLE}).get_current_revision()


def newest_revision() -> str:
    return _list_revisions()[0]


def _list_revisions() -> list[str]:
    """Return all known revisions, the newest first."""
    return [script.revision for script in ScriptDirectory(str(MIGRATIONS_FOLDER)).walk_revisions()]


def _check_no_foreign_tables(engine: Engine, connection: Connection) -> None:
    """Check that there are no tables of another program: they have no revision, or take the index's names."""
    found = set(inspect(connection).get_table_names())
    ours = found if engine.dialect.name == "sqlite" else found & set(IndexTable.metadata.tables)
    if ours:
        raise _unusable_index_error(engine.url, f"it is of something else (it has a table {min(ours)!r})")


def _unusable_index_error(url: URL, why: str) -> ServiceError:
    if url.get_backend_name() == "sqlite":
        advice = f"Build it anew from the recordings with `{REBUILD_COMMAND}`, which sets the old file aside."
    else:
        advice = f"Name an empty database in index_url, then fill it with `{REBUILD_COMMAND}`."
    return ServiceError(f"The index {display_url(url)} is not used: {why}. {advice}")
