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

from app.index.database_errors import REBUILD_COMMAND, describe_cause, display_url
from app.index.ingest import IndexedMessage
from app.index.store import Store
from app.messages.wire import Alarm

MAX_QUEUED_MESSAGES = 20_000  # messages; further ones are left out, counted and told: the files have them
MAX_BATCH_MESSAGES = 500
BATCH_DELAY_S = 0.02  # what comes together is written together: the event loop has the same interpreter
RETRY_DELAY_S = 2.0
CLOSE_TIMEOUT_S = 5.0
FLUSH_TIMEOUT_S = 1.0
BEHIND_TEXT = f"The index lacks what happened meanwhile: after the run, stop the service and `{REBUILD_COMMAND}`"
FAILED_TEXT = f"The index is not written any more (it failed inside): start the service again, then `{REBUILD_COMMAND}`"

QueuedMessage = tuple[IndexedMessage, str | None]
Answer = TypeVar("Answer")


class IndexWriter:
    """Writes what it takes, in order. While the database is at fault it keeps trying; up to `WAITING` messages wait.

    `on_fault` hears on the event loop what is wrong, once, and None when all is well again. What was left out stays
    known, also to the next service and `graspwatch index`, until a rebuild removes the file `marker`.
    """

    def __init__(self, store: Store, marker: Path, on_fault: Callable[[str | None], None]) -> None:
        self.store = store
        self._marker = marker
        self._is_behind = marker.exists()
        self.dropped_messages = 0
        self._on_fault = on_fault
        self._database_fault: str | None = None  # what the database is at fault with
        self._reported_fault: str | None = None
        self._queue: queue.Queue[QueuedMessage | threading.Event] = queue.Queue(MAX_QUEUED_MESSAGES)
        self._closing = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._run, name="index", daemon=True)  # it never holds up an exit

    def start(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._thread.start()
        self._report_fault()

    def enqueue(self, message: IndexedMessage, run_id: str | None = None) -> None:
        """Put a wire message into the index, soon. Never waits, never fails."""
        try:
            self._queue.put_nowait((message, run_id))
        except queue.Full:
            self._drop(1)
            self._report_fault()

    def _drop(self, messages: int) -> None:
        self.dropped_messages += messages
        self._is_behind = True
        with contextlib.suppress(OSError):  # it is tried again at the end, and the alarm is on
            self._marker.touch()

    async def wait_until_written(self) -> bool:
        """Wait until everything so far is written; False if the database is at fault or takes too long."""
        if self._database_fault or not self._thread.is_alive():
            return False
        written = threading.Event()
        try:
            self._queue.put_nowait(written)
        except queue.Full:
            return False
        return await asyncio.to_thread(written.wait, FLUSH_TIMEOUT_S)

    async def query(self, store_method: Callable[..., Answer], *arguments: Any) -> Answer:
        """Ask the store a question, of everything that has happened so far.

        Raises:
            ServiceError: the database is at fault.
        """
        await self.wait_until_written()
        return await asyncio.to_thread(store_method, *arguments)

    async def aclose(self) -> None:
        """Write what waits; what cannot be written in a few seconds is left to a rebuild, and said so in the log."""
        self._closing.set()
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(threading.Event())  # wakes the thread up
        if self._thread.is_alive():
            await asyncio.to_thread(self._thread.join, CLOSE_TIMEOUT_S)
        unwritten = sum(not isinstance(each, threading.Event) for each in list(self._queue.queue))
        if self.dropped_messages + unwritten:
            self._drop(unwritten)
            logging.getLogger("graspwatch").warning(
                "the index lacks %d messages: `%s`", self.dropped_messages, REBUILD_COMMAND
            )
        self.store.close()

    def _report_fault(self) -> None:
        """What is wrong now, where it is not what was told last."""
        fault = self._database_fault or (BEHIND_TEXT if self._is_behind else None)
        if fault == self._reported_fault or self._loop is None:
            return
        self._reported_fault = fault
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody listens any more
            self._loop.call_soon_threadsafe(self._on_fault, fault)

    # --- in the thread -----------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._write_loop()
        except BaseException:
            self._database_fault = FAILED_TEXT
            self._report_fault()
            raise

    def _write_loop(self) -> None:
        while not (self._closing.is_set() and self._queue.empty()):
            batch = self._next_batch()
            messages = _drop_superseded_alarms([each for each in batch if not isinstance(each, threading.Event)])
            while messages and not self._try_write(messages):
                if self._closing.wait(RETRY_DELAY_S):
                    self._drop(len(messages))
                    return
            for each in batch:
                if isinstance(each, threading.Event):
                    each.set()

    def _next_batch(self) -> list[QueuedMessage | threading.Event]:
        batch = [self._queue.get()]
        self._closing.wait(BATCH_DELAY_S)
        with contextlib.suppress(queue.Empty):
            while len(batch) < MAX_BATCH_MESSAGES:
                batch.append(self._queue.get_nowait())
        return batch

    def _try_write(self, messages: list[QueuedMessage]) -> bool:
        """False: the database is at fault, try again."""
        try:
            self.store.ingest_all(messages)
        except (StatementError, ValueError, OverflowError) as error:
            if isinstance(error, DBAPIError) and not isinstance(error, DataError | IntegrityError):
                self._database_fault = (
                    f"The index {display_url(self.store.url)} cannot be written: {describe_cause(error)}"
                )
                self._report_fault()
                return False
            if len(messages) > 1:  # one of them is at fault, not the database
                return all(self._try_write([message]) for message in messages)
            kind = type(messages[0][0]).__name__
            logging.getLogger("graspwatch").error("the index does not take %s: %s", kind, error)
            self._drop(1)
        self._database_fault = None
        self._report_fault()
        return True


def _drop_superseded_alarms(messages: list[QueuedMessage]) -> list[QueuedMessage]:
    """Without changes of an alarm that were overtaken meanwhile: while the force rises, there is one for each block."""
    last = {message.id: message for message, _ in messages if isinstance(message, Alarm)}
    return [each for each in messages if not isinstance(each[0], Alarm) or last[each[0].id] is each[0]]
