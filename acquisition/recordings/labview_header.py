"""The function that reads a LabVIEW file's headers, and classes for what they say of columns, numbers and times.

Format: https://www.ni.com/en/support/documentation/supplemental/06/specification-for-the-labview-measurement-file---lvm-.html
"""

import itertools
import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from config.errors import RecordingError

END_OF_HEADER = "***End_of_Header***"
X_HEADING, COMMENT_HEADING = "X_Value", "Comment"
FIRST_LINE = "LabVIEW Measurement"
SEPARATORS = {"Tab": "\t", "Comma": ",", "Semicolon": ";"}


class XColumns(StrEnum):
    """Which columns of times a file has: none, one, or one before each channel."""

    NO = "no"
    ONE = "one"
    MULTI = "multi"


@dataclass(frozen=True, slots=True)
class HeaderLine:
    """One line of a header: its number, and its cells without the name in front."""

    line: int
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Segment:
    """One segment: the lines of its header by their names, its headings, and the lines of its samples.

    `cells` of a header line stand under the headings: cell j belongs to column j, counted from 0 with the first column.
    """

    fields: dict[str, HeaderLine]
    end_line: int  # of its header
    headings: tuple[str, ...]
    first_row: int  # index of the line
    end_row: int  # index behind the last line

    @property
    def headings_line(self) -> int:
        return self.end_line + 1

    def cell(self, name: str, column: int) -> str:
        """Return what a header line says of a column, or an empty text."""
        field = self.fields.get(name)
        return field.cells[column] if field and column < len(field.cells) else ""

    def line_number(self, name: str) -> int:
        """Return the line number, in the file, of the header line with this name."""
        return self.fields[name].line


@dataclass(frozen=True, slots=True)
class LabviewHeader:
    """Contents of the headers of a LabVIEW measurement file."""

    separator: str
    decimal_comma: bool
    x_columns: XColumns
    is_absolute: bool  # its times may count from LabVIEW's time 0
    fields: dict[str, HeaderLine]
    segments: tuple[Segment, ...]

    @property
    def separator_name(self) -> str:
        return next(name for name, character in SEPARATORS.items() if character == self.separator)

    @property
    def decimal_text(self) -> str:
        return f"the decimal separator of this file is {',' if self.decimal_comma else '.'!r}"

    def parse_number(self, text: str) -> float:
        """Return the number that a cell holds.

        Raises:
            ValueError: it holds none.
        """
        text = text.strip()
        if self.decimal_comma:
            text = text.translate(DECIMAL_EXCHANGE)
        if not re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", text, re.ASCII):
            raise ValueError(text)
        return float(text)


DECIMAL_EXCHANGE = str.maketrans(",.", ".,")  # so that a point in a file with decimal commas is no number


def read_header(path: Path, lines: list[str]) -> LabviewHeader:
    """Read the headers of a LabVIEW measurement file.

    Raises:
        RecordingError: the file is none, or its header is damaged or of a kind that is not supported; the
            message names file and line.
    """
    _check_first_line(path, lines[0])
    ends = [i for i, line in enumerate(lines) if line.startswith(END_OF_HEADER)]
    if len(ends) < 2 or ends[-1] + 1 >= len(lines):
        raise RecordingError(
            f"{path}, line {len(lines)}: the file ends inside its header; expected two lines {END_OF_HEADER!r} "
            "and then the column names."
        )
    separator = _find_separator(path, lines[: ends[0]])
    fields = _read_fields(lines, 0, ends[0], separator)
    begins = [ends[0] + 1]
    for before, end in itertools.pairwise(ends[1:]):
        begins.append(_find_header_start(lines, before + 2, end, separator))
    segments = tuple(
        Segment(
            _read_fields(lines, begin, end, separator),
            end + 1,
            tuple(name.strip().strip('"') for name in lines[end + 1].split(separator)),
            end + 2,
            following,
        )
        for begin, end, following in zip(begins, ends[1:], [*begins[1:], len(lines)], strict=True)
    )
    x_columns = _read_x_columns(path, fields)
    is_comma = _has_decimal_comma(path, fields, segments, separator)
    is_absolute = _first(fields, "Time_Pref").casefold() == "absolute"
    return LabviewHeader(separator, is_comma, x_columns, is_absolute, fields, segments)


def _check_first_line(path: Path, line: str) -> None:
    if line.startswith(FIRST_LINE):
        return
    hint = ""
    if re.match(r"\s*[-+]?\d", line):
        hint = " A log without its header does not say what its columns are: write it with headers (one header only)."
    raise RecordingError(f"{path}, line 1: expected {FIRST_LINE!r}, found {line[:40]!r}.{hint}")


def _find_separator(path: Path, lines: list[str]) -> str:
    """Return the character between columns, which stands between the word `Separator` and its value, too."""
    number, line = next(((n, line) for n, line in enumerate(lines, 1) if line.startswith("Separator")), (0, ""))
    if not number:
        return "\t"
    used = line.removeprefix("Separator")[:1]
    named = line.removeprefix("Separator")[1:].strip("".join(SEPARATORS.values())).strip()
    known = {name.casefold(): character for name, character in SEPARATORS.items()}
    declared = known.get(named.casefold()) if named else used
    if declared is None or used not in known.values():
        raise RecordingError(
            f"{path}, line {number}: the separator {named or used!r} is not known; expected {', '.join(SEPARATORS)}. "
            "Write the file with one of them."
        )
    if declared != used:
        written = next(name for name, character in SEPARATORS.items() if character == used)
        raise RecordingError(
            f"{path}, line {number}: says that the separator is {named}, but {written} separates the columns. "
            f"Correct the line to {written}, or write the file anew."
        )
    return used


def _read_fields(lines: list[str], begin: int, end: int, separator: str) -> dict[str, HeaderLine]:
    """Return the lines of a header by their names, without special blocks; the first of each name counts."""
    fields: dict[str, HeaderLine] = {}
    inside_special = False
    for number, line in enumerate(lines[begin:end], begin + 1):
        inside_special = (inside_special or line.startswith("***Start_Special***")) and not line.startswith(
            "***End_Special***"
        )
        cells = tuple(cell.strip().strip('"') for cell in line.split(separator))
        if not inside_special and cells[0]:
            fields.setdefault(cells[0], HeaderLine(number, cells))
    return fields


def _find_header_start(lines: list[str], first: int, end: int, separator: str) -> int:
    """Return the index at which the header begins that ends at `end`: behind the last sample before it."""
    at = end
    while at > first and _is_header_line(lines[at - 1], separator):
        at -= 1
    return at


def is_blank(line: str, separator: str) -> bool:
    """Return whether a line holds nothing, or nothing between its separators."""
    return not line.strip(f"{separator} ").strip()


def _is_header_line(line: str, separator: str) -> bool:
    name = line.split(separator)[0].strip()
    return is_blank(line, separator) or bool(
        re.match(r"[A-Z*][A-Za-z0-9_*]", name) and name.casefold() not in ("nan", "inf")
    )


def _first(fields: dict[str, HeaderLine], name: str) -> str:
    field = fields.get(name)
    return field.cells[1] if field and len(field.cells) > 1 else ""


def _read_x_columns(path: Path, fields: dict[str, HeaderLine]) -> XColumns:
    told = _first(fields, "X_Columns") or XColumns.ONE
    try:
        return XColumns(told.casefold())
    except ValueError:
        raise RecordingError(
            f"{path}, line {fields['X_Columns'].line}: X_Columns {told!r} is not known; expected No, One or Multi."
        ) from None


def _has_decimal_comma(
    path: Path, fields: dict[str, HeaderLine], segments: tuple[Segment, ...], separator: str
) -> bool:
    """Return whether numbers have a decimal comma; files before version 2 do not say it, but their step shows it."""
    field = fields.get("Decimal_Separator")
    if field is None:
        told = "".join(cell for name in ("X0", "Delta_X") for s in segments for cell in _cells(s, name))
        return separator != "," and "," in told
    # with commas between the columns, a comma that is the value falls apart into empty cells
    told = field.cells[1] if len(field.cells) > 1 else ""
    if separator == "," and not told and len(field.cells) > 2:
        told = ","
    if told not in (".", ",", ""):
        raise RecordingError(f"{path}, line {field.line}: expected . or , as decimal separator, found {told!r}.")
    if told == separator:
        raise RecordingError(
            f"{path}, line {field.line}: the comma separates columns and decimals, so the numbers cannot be told. "
            "Write the file with Separator Tab."
        )
    return told == ","


def _cells(segment: Segment, name: str) -> tuple[str, ...]:
    field = segment.fields.get(name)
    return field.cells[1:] if field else ()
