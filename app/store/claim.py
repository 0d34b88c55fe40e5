"""Who uses an index: any number of services at once, or one rebuild alone. A claim ends with its process."""

import fcntl
import os
import time
from pathlib import Path
from typing import Self

from sqlalchemy import Connection, Engine, text

from app.store.database import faults_explained
from app.store.faults import shown
from config.errors import ServiceError

NUMBER = 0x67726177  # PostgreSQL's number of this lock
PATIENCE_S = 10.0


class Claim:
    """On the index of an engine; a context that gives it back.

    `first` says that nobody else had one: whatever the index calls under way is not. Who is first has it alone until
    `share`, so that no two make its tables at the same time.

    Raises:
        ServiceError: it is being rebuilt, or (`alone`) a service uses it, or the lock cannot be had at all.
    """

    def __init__(self, engine: Engine, *, alone: bool = False) -> None:
        self._lock: _FileLock | _ServerLock
        self._lock = _FileLock(engine) if engine.dialect.name == "sqlite" else _ServerLock(engine)
        self.first = self._lock.take(alone=True)
        if alone and not self.first:
            self.close()
            raise ServiceError(f"A service uses the index {shown(engine.url)}. Stop the service, then rebuild it.")
        if not self.first and not self._wait():
            self.close()
            raise ServiceError(f"The index {shown(engine.url)} is being rebuilt. Start again when that is done.")

    def share(self) -> None:
        """Let other services have it too."""
        self._lock.take(alone=False)

    def _wait(self) -> bool:
        """Another service that is just starting has it alone for a moment."""
        end_s = time.monotonic() + PATIENCE_S
        while not (taken := self._lock.take(alone=False)) and time.monotonic() < end_s:
            time.sleep(0.05)
        return taken

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._lock.close()


class _FileLock:
    """On a file beside the database."""

    def __init__(self, engine: Engine) -> None:
        path = Path(f"{engine.url.database}.lock")
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise ServiceError(
                f"The index {shown(engine.url)} cannot be used: {path} cannot be written ({error.strerror}). Make "
                "room, allow writing, or correct index_url."
            ) from None

    def take(self, *, alone: bool) -> bool:
        """A claim alone becomes one of many by taking it so."""
        try:
            fcntl.flock(self._file, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        os.close(self._file)


class _ServerLock:
    """On the server, as long as one connection lasts."""

    def __init__(self, engine: Engine) -> None:
        self._url = engine.url
        with faults_explained(self._url):
            self._connection: Connection = engine.connect().execution_options(isolation_level="AUTOCOMMIT")

    def take(self, *, alone: bool) -> bool:
        kind = "" if alone else "_shared"
        with faults_explained(self._url):
            taken = self._connection.scalar(text(f"SELECT pg_try_advisory_lock{kind}({NUMBER})"))
            if taken and not alone:
                self._connection.scalar(text(f"SELECT pg_advisory_unlock({NUMBER})"))  # which `first` may have left
        return bool(taken)

    def close(self) -> None:
        self._connection.invalidate()  # closed for good, not kept for others: the lock goes with it
        self._connection.close()
