"""Functions that make messages for people from database errors, without passwords."""

import sqlite3

from sqlalchemy import URL
from sqlalchemy.exc import DBAPIError

from config.errors import ServiceError

REBUILD_COMMAND = "graspwatch index --rebuild"
WRITE_CONFLICT_CODES = ("40001", "40P01")  # PostgreSQL: another writer changed the same row; try again
SQLITE_CAUSES = {
    sqlite3.SQLITE_READONLY: "the file or its folder is read-only: allow writing",
    sqlite3.SQLITE_CANTOPEN: "it cannot be opened: check that its folder is there and may be written to",
    sqlite3.SQLITE_FULL: "the disk is full: make room",
    sqlite3.SQLITE_IOERR: "the disk fails or is full: make room or mend it",
    sqlite3.SQLITE_PERM: "access is denied: allow writing",
    sqlite3.SQLITE_BUSY: "another program holds it: end that program",
    sqlite3.SQLITE_CORRUPT: f"it is damaged: stop the service, then `{REBUILD_COMMAND}`, which sets it aside",
    sqlite3.SQLITE_NOTADB: f"it is no database: stop the service, then `{REBUILD_COMMAND}`, which sets it aside",
}
POSTGRESQL_CAUSES = {
    "password authentication failed": "the password is wrong: put the right one into index_url or ~/.pgpass",
    "no password supplied": "it wants a password: put it into index_url or ~/.pgpass",
    "database": "there is no such database, or not for this user: make it with `createdb`, or correct index_url",
    "role": "there is no such user: make it with `createuser`, or correct index_url",
    "permission denied": "the user may not do this: let it own the database",
    "No space left": "the server's disk is full: make room",
    "failed to resolve host": "there is no such host: correct index_url",
    "refused": "nothing listens there: start the server, or correct index_url",
    "No such file or directory": "nothing listens there: start the server, or correct index_url",
    "timeout": "it does not answer: check the network and the server",
}


def display_url(url: URL) -> str:
    """Return a database's address for people, without its password."""
    if url.get_backend_name() == "sqlite":
        return str(url.database)
    return url.set(drivername="postgresql", query={}).render_as_string(hide_password=True)


def to_service_error(url: URL, error: DBAPIError) -> ServiceError:
    return ServiceError(f"The index {display_url(url)} cannot be used: {describe_cause(error)}.")


def describe_cause(error: DBAPIError) -> str:
    """Return what is wrong with a database, and what to do next, from its error."""
    original = error.orig
    if isinstance(original, sqlite3.Error):
        primary = getattr(original, "sqlite_errorcode", 0) & 0xFF  # the rest of the code is detail
        return SQLITE_CAUSES.get(primary, f"{original}: mend it, or `{REBUILD_COMMAND}`")
    text = " ".join(str(original).split())
    for words, meaning in POSTGRESQL_CAUSES.items():
        if words in text and (words not in ("database", "role") or "does not exist" in text):
            return meaning
    return f"{text.rstrip('.')}: see to the server, or correct index_url"


def is_write_conflict(error: DBAPIError) -> bool:
    """Return whether another writer was faster, so that another try helps."""
    return getattr(error.orig, "sqlstate", None) in WRITE_CONFLICT_CODES
