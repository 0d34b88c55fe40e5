"""The function that exports the journal, as its own lines or as a table."""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from app.audit.journal_file import find_journals, read_journal_lines
from app.messages.journal import JournalEntry
from app.messages.stored import read_stored

CSV_COLUMNS = (
    "number",
    "at",
    "kind",
    "action",
    "text",
    "by",
    "client",
    "result",
    "reason",
    "priority",
    "value",
    "limit",
    "unit",
    "hash",
)
FORMULA_PREFIXES = ("=", "+", "-", "@", "\t", "\r")


class JournalFormat(StrEnum):
    """The format of an export. `jsonl` keeps the lines byte for byte, so that their chain can be checked."""

    CSV = "csv"
    JSONL = "jsonl"


@dataclass(frozen=True, slots=True)
class JournalFilter:
    """A filter of journal lines; None matches any. Times without a zone are UTC."""

    since: datetime | None = None
    until: datetime | None = None
    by: str | None = None

    def matches(self, entry: JournalEntry) -> bool:
        at = _with_utc_zone(datetime.fromisoformat(entry.at))
        return (
            (self.since is None or at >= _with_utc_zone(self.since))
            and (self.until is None or at < _with_utc_zone(self.until))
            and (self.by is None or entry.by == self.by)
        )


def export_lines(data: Path, journal_filter: JournalFilter, journal_format: JournalFormat) -> Iterator[bytes]:
    """Yield the matching lines, oldest first, without unreadable ones (`graspwatch audit verify` reports those).

    Raises:
        JournalError: a file cannot be read.
    """
    if journal_format is JournalFormat.CSV:
        yield _csv_line(CSV_COLUMNS)
    for path in find_journals(data):
        for line in read_journal_lines(path):
            try:
                entry = read_stored(JournalEntry, line)
                taken = journal_filter.matches(entry)
            except ValueError:
                continue
            if taken:
                yield (
                    line.rstrip(b"\n") + b"\n"
                    if journal_format is JournalFormat.JSONL
                    else _csv_line(_csv_cells(entry))
                )


def _csv_cells(entry: JournalEntry) -> list[str]:
    return [_escape_formula(value) for value in (getattr(entry, name) for name in CSV_COLUMNS)]


def _escape_formula(value: object) -> str:
    """Return a cell that no spreadsheet takes for a formula: clients choose names and reasons freely."""
    if value is None:
        return ""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA_PREFIXES) else str(value)


def _csv_line(cells: tuple[str, ...] | list[str]) -> bytes:
    text = io.StringIO()
    csv.writer(text).writerow(cells)
    return text.getvalue().encode()


def _with_utc_zone(moment: datetime) -> datetime:
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
