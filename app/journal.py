"""What happened and who did it: one line of JSON each in `journal.jsonl`, the last ones also in memory."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from app.audit.file import JournalFile
from app.wire import JournalEntry, JournalKind, Result

KEPT = 2_000
log = logging.getLogger("graspwatch")


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
        self._sound = True
        self._waiting: deque[JournalEntry] = deque(maxlen=KEPT)
        self._entries: deque[JournalEntry] = deque(maxlen=KEPT)
        self._disk = ThreadPoolExecutor(1, "journal")
        self._sync: Future[None] | None = None

    def write(self, kind: JournalKind, text: str, **facts: Any) -> bool:
        """`facts`: other fields of `JournalEntry`. False: it is not in the file."""
        entry = JournalEntry(at=datetime.now(UTC).isoformat(timespec="microseconds"), kind=kind, text=text, **facts)
        log.info(text, extra={"kind": kind.value, "by": entry.by})
        self._waiting.append(entry)
        fault = None
        try:
            self._write_waiting()
            self._sync_soon()
        except OSError as error:
            fault = f"The journal {self._file.path} cannot be written ({error.strerror}): make room or mend it"
            if self._waiting:
                self._take(entry)
        if self._sound != (fault is None):
            self._sound = fault is None
            self._on_fault(fault)
        return fault is None

    def _write_waiting(self) -> None:
        """Lines that had to wait are told of again, now with their place in the journal."""
        while self._waiting:
            for placed in self._file.append(self._waiting[0]):
                self._take(placed)
            late = self._waiting.popleft()
            if late in self._entries:
                self._entries.remove(late)

    def _take(self, entry: JournalEntry) -> None:
        self._entries.append(entry)
        self._on_entry(entry)

    def deed(
        self, action: str, what: str, *, client: str, result: Result, by: str | None = None, reason: str | None = None
    ) -> bool:
        """Who did, or wanted, what, from where, and what came of it. False: it is not in the file."""
        facts = {"action": action, "client": client, "by": by, "reason": reason}
        words = {name: _writable(each) for name, each in facts.items() if each is not None}
        return self.write(JournalKind.REQUEST, f"{_writable(what)}: {result.value}", result=result, **words)

    def newest(self, most: int) -> list[JournalEntry]:
        """Newest first."""
        return list(self._entries)[: -most - 1 : -1]

    async def synced(self) -> bool:
        """Wait until everything so far is on the disk; False: it is not."""
        if self._waiting:
            return False
        try:
            if self._sync:
                await asyncio.wrap_future(self._sync)
        except OSError:
            return False
        return True

    def _sync_soon(self) -> None:
        """What is written while one waits for its turn goes with it: a burst of lines costs two.

        Raises:
            OSError: the one before could not bring the lines to the disk.
        """
        before = self._sync
        if before and not before.running() and not before.done():
            return
        self._sync = self._disk.submit(self._file.sync)
        if before and before.done():
            before.result()


def _writable(text: str) -> str:
    """A request may hold halves of characters, which no file takes."""
    return text.encode(errors="replace").decode()
