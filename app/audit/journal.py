"""What happened and who did it: one line of JSON each in `journal.jsonl`, the last ones also in memory."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from app.audit.journal_file import JournalFile
from app.messages.wire import JournalEntry, JournalKind, Result

MAX_ENTRIES_IN_MEMORY = 2_000
logger = logging.getLogger("graspwatch")


class Journal:
    """Appends to a file. A file that cannot be written is told once; the lines wait in memory until it can be.

    Every line is on the disk soon after it is written; `synced` waits for it.
    """

    def __init__(
        self, folder: Path, on_fault: Callable[[str | None], None], on_entry: Callable[[JournalEntry], None]
    ) -> None:
        """`on_fault` hears what is wrong with the file, and None once it can be written; `on_entry` every line."""
        self._file = JournalFile(folder)
        self._on_fault, self._on_entry = on_fault, on_entry
        self._file_writable = True
        self._unwritten: deque[JournalEntry] = deque(maxlen=MAX_ENTRIES_IN_MEMORY)
        self._entries: deque[JournalEntry] = deque(maxlen=MAX_ENTRIES_IN_MEMORY)
        self._sync_executor = ThreadPoolExecutor(1, "journal")
        self._sync_future: Future[None] | None = None

    def write(self, kind: JournalKind, text: str, **fields: Any) -> bool:
        """`facts`: other fields of `JournalEntry`. False: it is not in the file."""
        entry = JournalEntry(at=datetime.now(UTC).isoformat(timespec="microseconds"), kind=kind, text=text, **fields)
        logger.info(text, extra={"kind": kind.value, "by": entry.by})
        self._unwritten.append(entry)
        fault = None
        try:
            self._write_pending()
            self._schedule_sync()
        except OSError as error:
            fault = f"The journal {self._file.path} cannot be written ({error.strerror}): make room or mend it"
            if self._unwritten:
                self._add_entry(entry)
        if self._file_writable != (fault is None):
            self._file_writable = fault is None
            self._on_fault(fault)
        return fault is None

    def _write_pending(self) -> None:
        """Lines that had to wait are told of again, now with their place in the journal."""
        while self._unwritten:
            for placed in self._file.append(self._unwritten[0]):
                self._add_entry(placed)
            late = self._unwritten.popleft()
            if late in self._entries:
                self._entries.remove(late)

    def _add_entry(self, entry: JournalEntry) -> None:
        self._entries.append(entry)
        self._on_entry(entry)

    def write_request(
        self,
        action: str,
        description: str,
        *,
        client: str,
        result: Result,
        by: str | None = None,
        reason: str | None = None,
    ) -> bool:
        """Who did, or wanted, what, from where, and what came of it. False: it is not in the file."""
        facts = {"action": action, "client": client, "by": by, "reason": reason}
        words = {name: _replace_unencodable(each) for name, each in facts.items() if each is not None}
        return self.write(
            JournalKind.REQUEST, f"{_replace_unencodable(description)}: {result.value}", result=result, **words
        )

    def newest_entries(self, limit: int) -> list[JournalEntry]:
        """Newest first."""
        return list(self._entries)[: -limit - 1 : -1]

    async def wait_until_synced(self) -> bool:
        """Wait until everything so far is on the disk; False: it is not."""
        if self._unwritten:
            return False
        try:
            if self._sync_future:
                await asyncio.wrap_future(self._sync_future)
        except OSError:
            return False
        return True

    def _schedule_sync(self) -> None:
        """What is written while one waits for its turn goes with it: a burst of lines costs two.

        Raises:
            OSError: the one before could not bring the lines to the disk.
        """
        before = self._sync_future
        if before and not before.running() and not before.done():
            return
        self._sync_future = self._sync_executor.submit(self._file.sync)
        if before and before.done():
            before.result()


def _replace_unencodable(text: str) -> str:
    """A request may hold halves of characters, which no file takes."""
    return text.encode(errors="replace").decode()
