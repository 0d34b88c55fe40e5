"""The journal for others: its lines as they stand, or a table."""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from pydantic import ValidationError

from app.audit.journal_file import find_journals, read_journal_lines
from app.messages.wire import JournalEntry

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
    """`jsonl` can be checked again: its lines are those of the journal, byte for byte."""

    CSV = "csv"
    JSONL = "jsonl"


@dataclass(frozen=True, slots=True)
class JournalFilter:
    """Which lines; None: any. Moments without a zone are UTC."""

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
    """Lines, oldest first; what cannot be read as one is left out (`graspwatch audit verify` tells of it).

    Raises:
        JournalError: a file cannot be read.
    """
    if journal_format is JournalFormat.CSV:
        yield _csv_line(CSV_COLUMNS)
    for path in find_journals(data):
        for line in read_journal_lines(path):
            try:
                entry = JournalEntry.model_validate_json(line)
                taken = journal_filter.matches(entry)
            except (ValidationError, ValueError):
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
    """Names and reasons come from anybody: a spreadsheet must not take them for formulas."""
    if value is None:
        return ""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA_PREFIXES) else str(value)


def _csv_line(cells: tuple[str, ...] | list[str]) -> bytes:
    text = io.StringIO()
    csv.writer(text).writerow(cells)
    return text.getvalue().encode()


def _with_utc_zone(moment: datetime) -> datetime:
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
