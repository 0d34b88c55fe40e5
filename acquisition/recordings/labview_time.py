"""Functions that parse and format the dates and times of day in LabVIEW measurement files."""

import re
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

from acquisition.recordings.labview_header import LabviewHeader, Segment
from config.errors import RecordingError

NS_PER_S = 1_000_000_000
LABVIEW_EPOCH = datetime(1904, 1, 1, tzinfo=UTC)  # LabVIEW's time 0: that of a time which was never set
EPOCH_MARGIN = timedelta(hours=26)  # time 0 in any time zone
_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MIN_YEAR, MAX_YEAR = 1970, 2261  # of a recording's times: ns since 1970 in 64 bits

_YEAR_FIRST = re.compile(r"(\d{4})([/.-])(\d{1,2})\2(\d{1,2})")
_DAY_FIRST = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})")  # with dots; with slashes, the order would be a guess
_TIME = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d*))?)?\s*([AaPp])?\.?(?:[Mm]\.?)?")


def parse_date_and_time_ns(day: str, time: str) -> int:
    """Return the time of a date and a time of day, ns since 1970, as if they were UTC.

    Raises:
        ValueError: one of them is spelled otherwise, or there is no such day or time; the text says what is expected.
    """
    moment = datetime.combine(_parse_date(day.strip()), datetime.min.time(), UTC)
    return round((moment - _UNIX_EPOCH).total_seconds()) * NS_PER_S + _parse_time_of_day_ns(time.strip())


def _parse_date(text: str) -> date:
    if match := _YEAR_FIRST.fullmatch(text):
        year, _, month, day = match.groups()
    elif match := _DAY_FIRST.fullmatch(text):
        day, month, year = match.groups()
    else:
        raise ValueError(f"expected a date as 2024/03/05, year first, found {text[:40]!r}")
    try:
        return date(int(year), int(month), int(day))
    except ValueError:
        raise ValueError(f"there is no day {text!r}") from None


def _parse_time_of_day_ns(text: str) -> int:
    match = _TIME.fullmatch(text)
    if match is None:
        raise ValueError(f"expected a time of day as 10:11:12.5, found {text[:40]!r}")
    hour, minute, second = (int(part or 0) for part in match.groups()[:3])
    fraction, half = match[4] or "", (match[5] or "").lower()
    if half and not 1 <= hour <= 12:
        raise ValueError(f"there is no time of day {text!r}")
    if half:
        hour = hour % 12 + 12 * (half == "p")
    if hour > 23 or minute > 59 or second > 59:
        raise ValueError(f"there is no time of day {text!r}")
    return ((hour * 60 + minute) * 60 + second) * NS_PER_S + int(fraction[:9].ljust(9, "0"))


def is_never_set(time_ns: int) -> bool:
    """Return whether a time is LabVIEW's time 0 in any time zone, as of a clock that was never set."""
    return abs(_UNIX_EPOCH + timedelta(microseconds=time_ns // 1000) - LABVIEW_EPOCH) <= EPOCH_MARGIN


def convert_labview_seconds(seconds: float) -> int:
    """Return a number of seconds since LabVIEW's time 0 as ns since 1970."""
    whole = int(seconds)  # a product of so many seconds would lose microseconds
    since_epoch_ns = whole * NS_PER_S + round((seconds - whole) * 1e6) * 1000
    return round((LABVIEW_EPOCH - _UNIX_EPOCH).total_seconds()) * NS_PER_S + since_epoch_ns


def is_recordable(time_ns: int) -> bool:
    """Return whether a recording can hold the time."""
    return 0 <= time_ns < round((datetime(MAX_YEAR + 1, 1, 1, tzinfo=UTC) - _UNIX_EPOCH).total_seconds()) * NS_PER_S


def format_ns(time_ns: int) -> str:
    """Return the time in ISO 8601, to the microsecond, without a zone."""
    return (_UNIX_EPOCH + timedelta(microseconds=time_ns // 1000)).replace(tzinfo=None).isoformat()


class BaseTime(NamedTuple):
    """The date and time from which a segment's times count: ns since 1970, its line, and where it stands."""

    time_ns: int
    line: int
    source: str


def read_stamp_ns(path: Path, segment: Segment, column: int) -> int:
    """Return the start time of a column of a LabVIEW file's segment, by the segment's header, ns since 1970.

    Raises:
        RecordingError: they cannot be read; the text names line and column.
    """
    try:
        return parse_date_and_time_ns(segment.cell("Date", column), segment.cell("Time", column))
    except ValueError as error:
        line = segment.line_number("Time" if "time of day" in str(error) else "Date")
        raise RecordingError(f"{path}, line {line}, column {column + 1}: {error}. Correct it in a copy.") from None


def find_base_time(path: Path, header: LabviewHeader, segment: Segment, column: int) -> BaseTime | None:
    """Return the date and time that the times of a column count from, or None if the file says none.

    The samples' own date and time, in the header of their segment, count before those of the file.

    Raises:
        RecordingError: they cannot be read, or the clock was never set; the text names the line.
    """
    line = 0
    own = (segment.cell("Date", column), segment.cell("Time", column))
    if all(own):
        line, time_ns = segment.line_number("Date"), read_stamp_ns(path, segment, column)
        if not is_never_set(time_ns):
            return BaseTime(time_ns, line, "in a zone that it does not say")
    elif any(own):
        name, other = ("Date", "Time") if own[0] else ("Time", "Date")
        raise RecordingError(
            f"{path}, line {segment.line_number(name)}, column {column + 1}: says {name} without {other}. Add it in a "
            "copy."
        )
    day, time = header.fields.get("Date"), header.fields.get("Time")
    if day and time:
        time_ns = _parse_file_stamp(path, header)
        if not is_never_set(time_ns):
            source = "in a zone that it does not say" + (", from the file's header" if line else "")
            return BaseTime(time_ns, day.line, source)
        line = line or day.line
    if line:
        raise RecordingError(
            f"{path}, line {line}: says the time at which LabVIEW's clock begins, so it was never set. Correct Date "
            "and Time in a copy of the file."
        )
    return None


def _parse_file_stamp(path: Path, header: LabviewHeader) -> int:
    day, time = header.fields["Date"], header.fields["Time"]
    try:
        return parse_date_and_time_ns(" ".join(day.cells[1:2]), " ".join(time.cells[1:2]))
    except ValueError as error:
        line = time.line if "time of day" in str(error) else day.line
        raise RecordingError(f"{path}, line {line}: {error}. Correct it in a copy.") from None
