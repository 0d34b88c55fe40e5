"""What happened and who did it: one line of JSON each in `journal.jsonl`, the last ones also in memory."""

import logging
import os
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from app.wire import JournalEntry, JournalKind

KEPT = 2_000
NEW_LINE = "\n"


class Journal:
    """Appends to a file. A file that cannot be written is told once, and the lines go on in memory."""

    def __init__(
        self, folder: Path, on_fault: Callable[[str | None], None], on_entry: Callable[[JournalEntry], None]
    ) -> None:
        """`on_fault` hears what is wrong with the file, and None once it can be written; `on_entry` every line."""
        self._path = folder / "journal.jsonl"
        self._on_fault, self._on_entry = on_fault, on_entry
        self._sound = True
        self._whole = _ends_with_a_line(self._path)
        self._entries: deque[JournalEntry] = deque(maxlen=KEPT)

    def write(self, kind: JournalKind, text: str, **facts: Any) -> bool:
        """`facts`: other fields of `JournalEntry`. False: it is not in the file."""
        entry = JournalEntry(at=datetime.now(UTC).isoformat(timespec="microseconds"), kind=kind, text=text, **facts)
        self._entries.append(entry)
        self._on_entry(entry)
        logging.getLogger("graspwatch").info("%s: %s", kind.value, text)
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(f"{'' if self._whole else NEW_LINE}{entry.line()}{NEW_LINE}")
            self._whole = True
            if not self._sound:
                self._sound = True
                self._on_fault(None)
            return True
        except OSError as error:
            self._whole = False
            if self._sound:
                self._sound = False
                self._on_fault(f"The journal {self._path} cannot be written ({error.strerror}): make room or mend it")
            return False

    def newest(self, most: int) -> list[JournalEntry]:
        """Newest first."""
        return list(self._entries)[: -most - 1 : -1]


def _ends_with_a_line(path: Path) -> bool:
    """A power cut or a full disk may have left a part of one, which must not spoil the next."""
    try:
        with path.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read() == NEW_LINE.encode()
    except OSError:  # there is none yet, or it is empty, or what is wrong with it is told when it is written
        return True
