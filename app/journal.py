"""What happened and who did it: one line of JSON each in `journal.jsonl`, the last ones also in memory."""

import logging
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from app.wire import JournalEntry, JournalKind

KEPT = 2_000


class Journal:
    """Appends to a file. A file that cannot be written is told once, and the lines go on in memory."""

    def __init__(
        self, folder: Path, on_fault: Callable[[str | None], None], on_entry: Callable[[JournalEntry], None]
    ) -> None:
        """`on_fault` hears what is wrong with the file, and None once it can be written; `on_entry` every line."""
        self._path = folder / "journal.jsonl"
        self._on_fault, self._on_entry = on_fault, on_entry
        self._sound = True
        self._entries: deque[JournalEntry] = deque(maxlen=KEPT)

    def write(self, kind: JournalKind, text: str, **facts: Any) -> None:
        """`facts`: other fields of `JournalEntry`."""
        entry = JournalEntry(at=datetime.now(UTC).isoformat(timespec="milliseconds"), kind=kind, text=text, **facts)
        self._entries.append(entry)
        self._on_entry(entry)
        logging.getLogger("graspwatch").info("%s: %s", kind.value, text)
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(entry.model_dump_json(exclude_none=True) + "\n")
            if not self._sound:
                self._sound = True
                self._on_fault(None)
        except OSError as error:
            if self._sound:
                self._sound = False
                self._on_fault(f"The journal {self._path} cannot be written ({error.strerror}): make room or mend it")

    def newest(self, most: int) -> list[JournalEntry]:
        """Newest first."""
        return list(self._entries)[: -most - 1 : -1]
