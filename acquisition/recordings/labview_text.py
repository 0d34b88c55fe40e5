"""Text of a LabVIEW measurement file: unpacked, decoded, bounded, in lines."""

import codecs
import contextlib
import gzip
import re
import zlib
from pathlib import Path

from config.errors import RecordingError

MAX_TEXT_BYTES = 256 * 2**20  # text of more than an hour
MAX_LINES = 5_000_000  # each takes many times its length in memory
LINE_ENDS = re.compile("\r\n|\n|\r")
GZIP_MAGIC = b"\x1f\x8b"
UTF_16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_lines(path: Path) -> list[str]:
    """Return the lines of a file, without their ends; a file that is packed by gzip is unpacked.

    Raises:
        RecordingError: the file cannot be read, is no text, or is too long; the text names file and line.
    """
    try:
        with path.open("rb") as file:
            packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC or path.suffix.lower() == ".gz"
        with gzip.open(path) if packed else path.open("rb") as file:
            content = file.read(MAX_TEXT_BYTES + 1)
    except FileNotFoundError:
        raise RecordingError(f"{path}: there is no such file. Check the path.") from None
    except EOFError:
        raise RecordingError(f"{path}: the compressed file is cut off before its end. Copy it again.") from None
    except (gzip.BadGzipFile, zlib.error) as error:
        raise RecordingError(f"{path}: is not a sound gzip file ({error}). Copy it again.") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}).") from None
    if len(content) > MAX_TEXT_BYTES:
        raise RecordingError(f"{path}: holds more than {MAX_TEXT_BYTES // 2**20} MiB of text. Split it.")
    text = _decode(path, content)
    if text.count("\n") + text.count("\r") > MAX_LINES:
        raise RecordingError(f"{path}: holds more than {MAX_LINES} lines. Split it.")
    if not text.strip():
        raise RecordingError(f"{path}: is empty; expected a LabVIEW measurement file.")
    lines = LINE_ENDS.split(text)
    if not lines[-1]:
        lines.pop()
    elif _is_truncated(lines):
        raise RecordingError(
            f"{path}, line {len(lines)}: the file is cut off in its last number. Copy it again, or delete the line."
        )
    return lines


def _decode(path: Path, content: bytes) -> str:
    """Decode UTF-8, UTF-16 with a byte order mark, or one of the 8-bit code pages of Windows.

    All code pages have the same digits and separators; only names and comments may show other letters.
    """
    try:
        if content.startswith(UTF_16_MARKS):
            return content.decode("utf-16")
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if b"\0" not in content:
            with contextlib.suppress(UnicodeDecodeError):
                return content.decode("cp1252")
            return content.decode("latin-1")
        line = content[: error.start].count(b"\n") + 1
        raise RecordingError(f"{path}, line {line}: is binary; expected a LabVIEW measurement file (text).") from None


def _is_truncated(lines: list[str]) -> bool:
    """Return whether the last line has all columns, but fewer decimals in its last number than the line above."""
    if len(lines) < 2:
        return False
    above, last = (re.split("[\t;]" if "\t" in line or ";" in line else ",", line.strip()) for line in lines[-2:])
    return len(last) == len(above) and _count_decimals(last[-1]) < _count_decimals(above[-1])


def _count_decimals(number: str) -> int:
    return len(re.split("[.,]", number, maxsplit=1)[-1]) if re.search("[.,]", number) else 0
