"""The index as the service keeps it: messages are taken at once and written by a thread, so that a slow or broken
database never holds the event loop up, let alone a run."""

import asyncio
import contextlib
import logging
import queue
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from sqlalchemy.exc import DataError, DBAPIError, IntegrityError

from app.store.faults import REBUILD, cause, shown
from app.store.store import Store
from app.store.taking import Indexed

WAITING = 20_000  # messages; further ones are left out, counted and told: the files have them
AT_ONCE = 500
AGAIN_S = 2.0
LAST_WORDS_S = 5.0
SETTLED_S = 1.0

Taken = tuple[Indexed, str | None]
Answer = TypeVar("Answer")


class Index:
    """Writes what it takes, in order. While the database is at fault it keeps trying; up to `WAITING` messages wait.

    `on_fault` hears on the event loop what is wrong, once, and None when all is well again.
    """

    def __init__(self, store: Store, on_fault: Callable[[str | None], None]) -> None:
        self.store = store
        self.left_out = 0
        self._on_fault = on_fault
        self._fault: str | None = None
        self._queue: queue.Queue[Taken | threading.Event] = queue.Queue(WAITING)
        self._closing = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._write, name="index", daemon=True)  # it never holds up an exit

    def start(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._thread.start()

    def take(self, message: Indexed, run_id: str | None = None) -> None:
        """Put a wire message into the index, soon. Never waits, never fails."""
        try:
            self._queue.put_nowait((message, run_id))
        except queue.Full:
            self._leave_out()

    async def settled(self) -> bool:
        """Wait until everything so far is written; False if the database is at fault or takes too long."""
        if self._fault or not self._thread.is_alive():
            return False
        written = threading.Event()
        try:
            self._queue.put_nowait(written)
        except queue.Full:
            return False
        return await asyncio.to_thread(written.wait, SETTLED_S)

    async def ask(self, question: Callable[..., Answer], *arguments: Any) -> Answer:
        """Ask the store a question, of everything that has happened so far.

        Raises:
            ServiceError: the database is at fault.
        """
        await self.settled()
        return await asyncio.to_thread(question, *arguments)

    async def close(self) -> None:
        """Write what waits; what cannot be written in a few seconds is left to a rebuild, and said so in the log."""
        self._closing.set()
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(threading.Event())  # wakes the thread up
        if self._thread.is_alive():
            await asyncio.to_thread(self._thread.join, LAST_WORDS_S)
        missing = self._queue.qsize() + self.left_out
        if missing:
            logging.getLogger("graspwatch").warning("the index lacks %d messages: `%s`", missing, REBUILD)
        self.store.close()

    # --- in the thread -----------------------------------------------------------------------------------------------

    def _write(self) -> None:
        while not (self._closing.is_set() and self._queue.empty()):
            batch = self._next()
            messages = [each for each in batch if not isinstance(each, threading.Event)]
            while messages and not self._written(messages):
                if self._closing.wait(AGAIN_S):
                    self.left_out += len(messages)
                    return
            for each in batch:
                if isinstance(each, threading.Event):
                    each.set()

    def _next(self) -> list[Taken | threading.Event]:
        batch = [self._queue.get()]
        with contextlib.suppress(queue.Empty):
            while len(batch) < AT_ONCE:
                batch.append(self._queue.get_nowait())
        return batch

    def _written(self, messages: list[Taken]) -> bool:
        """False: the database is at fault, try again."""
        try:
            self.store.take_all(messages)
        except (DataError, IntegrityError, ValueError, OverflowError) as error:  # a message is, not the database
            if len(messages) > 1:
                return all(self._written([message]) for message in messages)
            logging.getLogger("graspwatch").error(
                "the index does not take %s: %s", type(messages[0][0]).__name__, error
            )
            self._leave_out()
            return True
        except DBAPIError as error:
            self._tell(f"The index {shown(self.store.url)} cannot be written: {cause(error)}")
            return False
        if self._fault and not self.left_out:
            self._tell(None)
        elif self.left_out:
            self._tell(self._behind())
        return True

    def _leave_out(self) -> None:
        self.left_out += 1
        if not self._fault:
            self._tell(self._behind())

    def _behind(self) -> str:
        return f"The index lacks what happened meanwhile: after the run, stop the service and `{REBUILD}`"

    def _tell(self, fault: str | None) -> None:
        if fault == self._fault or self._loop is None:
            return
        self._fault = fault
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody listens any more
            self._loop.call_soon_threadsafe(self._on_fault, fault)
