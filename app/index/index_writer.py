"""The class IndexWriter: a queue and a thread, so that a slow database never blocks the service's event loop."""

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
from app.messages.alarms import Alarm

MAX_QUEUED_MESSAGES = 20_000  # further ones are dropped, counted and reported: the files have them
MAX_BATCH_MESSAGES = 500
BATCH_DELAY_S = 0.02  # writes messages in batches, because the event loop shares the interpreter
RETRY_DELAY_S = 2.0
CLOSE_TIMEOUT_S = 5.0
FLUSH_TIMEOUT_S = 1.0
BEHIND_TEXT = f"The index lacks what happened meanwhile: after the run, stop the service and `{REBUILD_COMMAND}`"
FAILED_TEXT = f"The index is not written any more (it failed inside): start the service again, then `{REBUILD_COMMAND}`"

QueuedMessage = tuple[IndexedMessage, str | None]
Answer = TypeVar("Answer")


class IndexWriter:
    """Writer of messages in order. While the database is at fault it retries, and up to MAX_QUEUED_MESSAGES wait.

    `on_fault` is called on the event loop once a fault begins, and with None when it is over. The file `marker` records
    that messages were dropped, also for the next service and `graspwatch index`, until a rebuild removes it.
    """

    def __init__(self, store: Store, marker: Path, on_fault: Callable[[str | None], None]) -> None:
        self.store = store
        self._marker = marker
        self._is_behind = marker.exists()
        self.dropped_messages = 0
        self._on_fault = on_fault
        self._database_fault: str | None = None  # the database's present fault
        self._reported_fault: str | None = None
        self._queue: queue.Queue[QueuedMessage | threading.Event] = queue.Queue(MAX_QUEUED_MESSAGES)
        self._closing = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._run, name="index", daemon=True)  # never delays an exit

    def start(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._thread.start()
        self._report_fault()

    def enqueue(self, message: IndexedMessage, run_id: str | None = None) -> None:
        """Queue a record for the index. Never blocks, never fails."""
        try:
            self._queue.put_nowait((message, run_id))
        except queue.Full:
            self._drop(1)
            self._report_fault()

    def _drop(self, messages: int) -> None:
        self.dropped_messages += messages
        self._is_behind = True
        with contextlib.suppress(OSError):  # the alarm is on, and `aclose` tries again
            self._marker.touch()

    async def wait_until_written(self) -> bool:
        """Wait until all queued messages are written; return False if the database is at fault or too slow."""
        if self._database_fault or not self._thread.is_alive():
            return False
        written = threading.Event()
        try:
            self._queue.put_nowait(written)
        except queue.Full:
            return False
        return await asyncio.to_thread(written.wait, FLUSH_TIMEOUT_S)

    async def query(self, store_method: Callable[..., Answer], *arguments: Any) -> Answer:
        """Call a method of the store in a thread, after all messages queued so far are written.

        Raises:
            ServiceError: the database is at fault.
        """
        await self.wait_until_written()
        return await asyncio.to_thread(store_method, *arguments)

    async def aclose(self) -> None:
        """Write the queued messages and close the store; log those that a few seconds do not suffice for."""
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
        """Call `on_fault` if the fault has changed since the last report."""
        fault = self._database_fault or (BEHIND_TEXT if self._is_behind else None)
        if fault == self._reported_fault or self._loop is None:
            return
        self._reported_fault = fault
        with contextlib.suppress(RuntimeError):  # the event loop is closed
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
        """Write the messages; return False if the database is at fault and should be tried again."""
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
    """Drop all but the last change of each alarm: while the force rises, there is one a block."""
    last = {message.id: message for message, _ in messages if isinstance(message, Alarm)}
    return [each for each in messages if not isinstance(each[0], Alarm) or last[each[0].id] is each[0]]
