"""The class IndexLock: shared by any number of services, or exclusive to one rebuild. It ends with its process."""

import fcntl
import os
import time
from pathlib import Path
from typing import Self

from sqlalchemy import Connection, Engine, text

from app.index.database import explain_database_errors
from app.index.database_errors import display_url
from config.errors import ServiceError

INDEX_LOCK_ID = 0x67726177  # key of PostgreSQL's lock
LOCK_TIMEOUT_S = 10.0


class IndexLock:
    """Lock on the index of an engine; a context that releases it.

    `had_no_other_user` says that no other service had the lock: then no run listed as under way still is. Such a first
    user has the lock exclusively until `downgrade_to_shared`, so that only one process creates the tables.

    Raises:
        ServiceError: a rebuild has the lock, or (`exclusive`) a service, or the lock cannot be acquired at all.
    """

    def __init__(self, engine: Engine, *, exclusive: bool = False) -> None:
        self._lock: _FileLock | _AdvisoryLock
        self._lock = _FileLock(engine) if engine.dialect.name == "sqlite" else _AdvisoryLock(engine)
        self.had_no_other_user = self._lock.acquire(exclusive=True)
        if exclusive and not self.had_no_other_user:
            self.close()
            raise ServiceError(
                f"A service uses the index {display_url(engine.url)}. Stop the service, then rebuild it."
            )
        if not self.had_no_other_user and not self._wait_for_shared():
            self.close()
            raise ServiceError(f"The index {display_url(engine.url)} is being rebuilt. Start again when that is done.")

    def downgrade_to_shared(self) -> None:
        """Let other services acquire the lock, too."""
        self._lock.acquire(exclusive=False)

    def _wait_for_shared(self) -> bool:
        """Wait for a service that holds the lock exclusively for a moment while it starts; return success."""
        end_s = time.monotonic() + LOCK_TIMEOUT_S
        while not (taken := self._lock.acquire(exclusive=False)) and time.monotonic() < end_s:
            time.sleep(0.05)
        return taken

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._lock.close()


class _FileLock:
    """A lock on a file beside the database."""

    def __init__(self, engine: Engine) -> None:
        path = Path(f"{engine.url.database}.lock")
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise ServiceError(
                f"The index {display_url(engine.url)} cannot be used: {path} cannot be written ({error.strerror}). "
                f"Make "
                "room, allow writing, or correct index_url."
            ) from None

    def acquire(self, *, exclusive: bool) -> bool:
        """Acquire the lock, or change its mode; return success."""
        try:
            fcntl.flock(self._file, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        os.close(self._file)


class _AdvisoryLock:
    """A lock on the PostgreSQL server, held as long as one connection."""

    def __init__(self, engine: Engine) -> None:
        self._url = engine.url
        with explain_database_errors(self._url):
            self._connection: Connection = engine.connect().execution_options(isolation_level="AUTOCOMMIT")

    def acquire(self, *, exclusive: bool) -> bool:
        kind = "" if exclusive else "_shared"
        with explain_database_errors(self._url):
            taken = self._connection.scalar(text(f"SELECT pg_try_advisory_lock{kind}({INDEX_LOCK_ID})"))
            if taken and not exclusive:
                self._connection.scalar(
                    text(f"SELECT pg_advisory_unlock({INDEX_LOCK_ID})")
                )  # of the first user, from its start
        return bool(taken)

    def close(self) -> None:
        self._connection.invalidate()  # closes the connection instead of pooling it, which releases the lock
        self._connection.close()
