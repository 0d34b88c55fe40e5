"""The index as the service keeps it: messages are taken at once and written by a thread, so that a slow or broken
database never holds the event loop up, let alone a run."""

import asyncio
import contextlib
import logging
import queue
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy.exc import DataError, DBAPIError, IntegrityError, StatementError

from app.store.faults import REBUILD, cause, shown
from app.store.store import Store
from app.store.taking import Indexed
from app.wire import Alarm

WAITING = 20_000  # messages; further ones are left out, counted and told: the files have them
AT_ONCE = 500
GATHER_S = 0.02  # what comes together is written together: the event loop has the same interpreter
AGAIN_S = 2.0
LAST_WORDS_S = 5.0
SETTLED_S = 1.0
BEHIND = f"The index lacks what happened meanwhile: after the run, stop the service and `{REBUILD}`"
FAILED = f"The index is not written any more (it failed inside): start the service again, then `{REBUILD}`"

Taken = tuple[Indexed, str | None]
Answer = TypeVar("Answer")


class Index:
    """Writes what it takes, in order. While the database is at fault it keeps trying; up to `WAITING` messages wait.

    `on_fault` hears on the event loop what is wrong, once, and None when all is well again. What was left out stays
    known, also to the next service and `graspwatch index`, until a rebuild removes the file `marker`.
    """

    def __init__(self, store: Store, marker: Path, on_fault: Callable[[str | None], None]) -> None:
        self.store = store
        self._marker = marker
        self._behind = marker.exists()
        self.left_out = 0
        self._on_fault = on_fault
        self._broken: str | None = None  # what the database is at fault with
        self._told: str | None = None
        self._queue: queue.Queue[Taken | threading.Event] = queue.Queue(WAITING)
        self._closing = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._work, name="index", daemon=True)  # it never holds up an exit

    def start(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._thread.start()
        self._tell()

    def take(self, message: Indexed, run_id: str | None = None) -> None:
        """Put a wire message into the index, soon. Never waits, never fails."""
        try:
            self._queue.put_nowait((message, run_id))
        except queue.Full:
            self._leave_out(1)
            self._tell()

    def _leave_out(self, messages: int) -> None:
        self.left_out += messages
        self._behind = True
        with contextlib.suppress(OSError):  # it is tried again at the end, and the alarm is on
            self._marker.touch()

    async def settled(self) -> bool:
        """Wait until everything so far is written; False if the database is at fault or takes too long."""
        if self._broken or not self._thread.is_alive():
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

    async def aclose(self) -> None:
        """Write what waits; what cannot be written in a few seconds is left to a rebuild, and said so in the log."""
        self._closing.set()
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(threading.Event())  # wakes the thread up
        if self._thread.is_alive():
            await asyncio.to_thread(self._thread.join, LAST_WORDS_S)
        unwritten = sum(not isinstance(each, threading.Event) for each in list(self._queue.queue))
        if self.left_out + unwritten:
            self._leave_out(unwritten)
            logging.getLogger("graspwatch").warning("the index lacks %d messages: `%s`", self.left_out, REBUILD)
        self.store.close()

    def _tell(self) -> None:
        """What is wrong now, where it is not what was told last."""
        fault = self._broken or (BEHIND if self._behind else None)
        if fault == self._told or self._loop is None:
            return
        self._told = fault
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody listens any more
            self._loop.call_soon_threadsafe(self._on_fault, fault)

    # --- in the thread -----------------------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            self._write()
        except BaseException:
            self._broken = FAILED
            self._tell()
            raise

    def _write(self) -> None:
        while not (self._closing.is_set() and self._queue.empty()):
            batch = self._next()
            messages = _newest([each for each in batch if not isinstance(each, threading.Event)])
            while messages and not self._written(messages):
                if self._closing.wait(AGAIN_S):
                    self._leave_out(len(messages))
                    return
            for each in batch:
                if isinstance(each, threading.Event):
                    each.set()

    def _next(self) -> list[Taken | threading.Event]:
        batch = [self._queue.get()]
        self._closing.wait(GATHER_S)
        with contextlib.suppress(queue.Empty):
            while len(batch) < AT_ONCE:
                batch.append(self._queue.get_nowait())
        return batch

    def _written(self, messages: list[Taken]) -> bool:
        """False: the database is at fault, try again."""
        try:
            self.store.take_all(messages)
        except (StatementError, ValueError, OverflowError) as error:
            if isinstance(error, DBAPIError) and not isinstance(error, DataError | IntegrityError):
                self._broken = f"The index {shown(self.store.url)} cannot be written: {cause(error)}"
                self._tell()
                return False
            if len(messages) > 1:  # one of them is at fault, not the database
                return all(self._written([message]) for message in messages)
            kind = type(messages[0][0]).__name__
            logging.getLogger("graspwatch").error("the index does not take %s: %s", kind, error)
            self._leave_out(1)
        self._broken = None
        self._tell()
        return True


def _newest(messages: list[Taken]) -> list[Taken]:
    """Without changes of an alarm that were overtaken meanwhile: while the force rises, there is one for each block."""
    last = {message.id: message for message, _ in messages if isinstance(message, Alarm)}
    return [each for each in messages if not isinstance(each[0], Alarm) or last[each[0].id] is each[0]]
