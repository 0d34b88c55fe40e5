"""The function that reads a text file: unpacked, decoded, of bounded length."""

import codecs
import contextlib
import gzip
import re
import zlib
from pathlib import Path

from config.errors import RecordingError

MAX_TEXT_BYTES = 256 * 2**20  # text of more than an hour
MAX_LINES = 5_000_000  # each takes many times its length in memory
GZIP_MAGIC = b"\x1f\x8b"
UTF_16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: Path, expected: str) -> str:
    """Return the text of a file; a file that is packed by gzip is unpacked. `expected` says what it should be.

    Raises:
        RecordingError: the file cannot be read, is no text, is empty or too long; the text names file and line.
    """
    content = read_bytes(path, MAX_TEXT_BYTES + 1)
    if len(content) > MAX_TEXT_BYTES:
        raise RecordingError(f"{path}: holds more than {MAX_TEXT_BYTES // 2**20} MiB of text. Split it.")
    text = _decode(path, content, expected)
    if text.count("\n") + text.count("\r") > MAX_LINES:
        raise RecordingError(f"{path}: holds more than {MAX_LINES} lines. Split it.")
    if not text.strip():
        raise RecordingError(f"{path}: is empty; expected {expected}.")
    return text


def read_bytes(path: Path, count: int) -> bytes:
    """Return the first `count` bytes of a file, unpacked if it is packed by gzip.

    Raises:
        RecordingError: the file cannot be read or unpacked.
    """
    try:
        with path.open("rb") as file:
            packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC or path.suffix.lower() == ".gz"
        with gzip.open(path) if packed else path.open("rb") as file:
            return file.read(count)
    except FileNotFoundError:
        raise RecordingError(f"{path}: there is no such file. Check the path.") from None
    except EOFError:
        raise RecordingError(f"{path}: the compressed file is cut off before its end. Copy it again.") from None
    except (gzip.BadGzipFile, zlib.error) as error:
        raise RecordingError(f"{path}: is not a sound gzip file ({error}). Copy it again.") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}).") from None


def _decode(path: Path, content: bytes, expected: str) -> str:
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
        raise RecordingError(f"{path}, line {line}: is binary; expected {expected} (text).") from None


def count_decimals(number: str) -> int:
    """Return how many digits follow the decimal mark of a number."""
    return len(re.split("[.,]", number, maxsplit=1)[-1]) if re.search("[.,]", number) else 0
