"""The class Journal, which writes events and requests as JSON lines to `journal.jsonl`, the newest also in memory."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from app.audit.journal_file import JournalFile
from app.messages.journal import JournalEntry, JournalKind, Result

MAX_ENTRIES_IN_MEMORY = 2_000
logger = logging.getLogger("graspwatch")


class Journal:
    """A writer of the journal. If the file cannot be written, it reports that once and keeps the lines in memory.

    Every line is on the disk soon after it is written; `wait_until_synced` waits for that.
    """

    def __init__(
        self, folder: Path, on_fault: Callable[[str | None], None], on_entry: Callable[[JournalEntry], object]
    ) -> None:
        """`on_fault` receives the file's error, or None once it can be written again; `on_entry` each entry."""
        self._file = JournalFile(folder)
        self._on_fault, self._on_entry = on_fault, on_entry
        self._file_writable = True
        self._unwritten: deque[JournalEntry] = deque(maxlen=MAX_ENTRIES_IN_MEMORY)
        self._entries: deque[JournalEntry] = deque(maxlen=MAX_ENTRIES_IN_MEMORY)
        self._sync_executor = ThreadPoolExecutor(1, "journal")
        self._sync_future: Future[None] | None = None

    def write(self, kind: JournalKind, text: str, **fields: Any) -> bool:
        """Write an entry; `fields` are further fields of `JournalEntry`. Return False if the file cannot be written."""
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
        """Write waiting entries to the file; each replaces its copy in memory, which had no place in the chain."""
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
        """Write an entry about a request and its result. Return False if the file cannot be written."""
        facts = {"action": action, "client": client, "by": by, "reason": reason}
        words = {name: _replace_unencodable(each) for name, each in facts.items() if each is not None}
        return self.write(
            JournalKind.REQUEST, f"{_replace_unencodable(description)}: {result.value}", result=result, **words
        )

    def newest_entries(self, limit: int) -> list[JournalEntry]:
        """Return the newest entries, newest first."""
        return list(self._entries)[: -limit - 1 : -1]

    async def wait_until_synced(self) -> bool:
        """Wait until all entries are on the disk; return False if that fails."""
        if self._unwritten:
            return False
        try:
            if self._sync_future:
                await asyncio.wrap_future(self._sync_future)
        except OSError:
            return False
        return True

    def _schedule_sync(self) -> None:
        """Schedule a sync, unless one waits that will include the newest line: a burst of lines costs two syncs.

        Raises:
            OSError: the sync before failed.
        """
        before = self._sync_future
        if before and not before.running() and not before.done():
            return
        self._sync_future = self._sync_executor.submit(self._file.sync)
        if before and before.done():
            before.result()


def _replace_unencodable(text: str) -> str:
    """Replace the lone surrogates that a request may hold, because UTF-8 cannot encode them."""
    return text.encode(errors="replace").decode()
