"""Functions that read the lines of a LabVIEW measurement file, and recognize one."""

import re
from pathlib import Path

from acquisition.recordings.labview_header import FIRST_LINE
from acquisition.recordings.text_file import count_decimals, read_bytes, read_text
from config.errors import RecordingError

LINE_ENDS = re.compile("\r\n|\n|\r")
BYTE_ORDER_MARKS = b"\xef\xbb\xbf\xff\xfe"


def starts_like_labview(path: Path) -> bool:
    """Return whether a file begins as LabVIEW measurement files do.

    Raises:
        RecordingError: the file cannot be read or unpacked.
    """
    start = read_bytes(path, 2 * len(FIRST_LINE) + len(BYTE_ORDER_MARKS))  # UTF-16 has two bytes a letter
    return start.lstrip(BYTE_ORDER_MARKS).replace(b"\0", b"").startswith(FIRST_LINE.encode())


def read_lines(path: Path) -> list[str]:
    """Return the lines of a file, without their ends; a file that is packed by gzip is unpacked.

    Raises:
        RecordingError: the file cannot be read, is no text, or is too long; the text names file and line.
    """
    lines = LINE_ENDS.split(read_text(path, "a LabVIEW measurement file"))
    if not lines[-1]:
        lines.pop()
    elif _is_truncated(lines):
        raise RecordingError(
            f"{path}, line {len(lines)}: the file is cut off in its last number. Copy it again, or delete the line."
        )
    return lines


def _is_truncated(lines: list[str]) -> bool:
    """Return whether the last line has all columns, but fewer decimals in its last number than the line above."""
    if len(lines) < 2:
        return False
    above, last = (re.split("[\t;]" if "\t" in line or ";" in line else ",", line.strip()) for line in lines[-2:])
    return len(last) == len(above) and count_decimals(last[-1]) < count_decimals(above[-1])
