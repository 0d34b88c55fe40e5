"""Function that reads numbers from the columns of a text file."""

import gzip
import re
import zlib
from collections.abc import Mapping
from math import isfinite
from pathlib import Path

import numpy as np

from config.errors import RecordingError

COMMENT_MARKS = ("%", "#")
SEPARATORS = ("\t", ";", ",")  # else blanks


def read_columns(path: Path, positions: Mapping[str, int]) -> dict[str, np.ndarray]:
    """Read the named columns, (n,) each, of a text file, which may be compressed with gzip.

    Lines that begin with % or #, empty lines and one line of headers before the numbers are skipped. The first row
    tells the separator: tab, semicolon, comma or blanks.

    Args:
        path: of the file.
        positions: column of each name, counted from 1.

    Raises:
        RecordingError: the file cannot be read, or a row has no finite number in a named column.
    """
    found: dict[str, list[float]] = {name: [] for name in positions}
    separator: str | None = None
    width = 0
    try:
        with gzip.open(path, "rt", encoding="utf-8") if path.suffix == ".gz" else path.open(encoding="utf-8") as lines:
            for number, line in enumerate(lines, 1):
                text = line.strip()
                if not text or text.startswith(COMMENT_MARKS):
                    continue
                if not width:
                    separator = next((each for each in SEPARATORS if each in text), None)
                cells = text.split(separator)
                if not width:
                    width = len(cells)
                    if not re.search(r"(^|[\s,;])[-+.]?\d", text):
                        continue  # headers
                if len(cells) != width:
                    raise RecordingError(
                        f"{path}, line {number}: {len(cells)} columns, and {width} before: correct the line."
                    )
                for name, position in positions.items():
                    if position > width:
                        raise RecordingError(
                            f"{path} has {width} columns, and none at {position} for {name}: correct --columns."
                        )
                    found[name].append(_read_number(cells[position - 1], path, number, name))
    except (OSError, EOFError, UnicodeDecodeError, zlib.error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "no text, or damaged"
        raise RecordingError(f"{path}: cannot be read ({reason}). Name a text file with columns of numbers.") from None
    if not all(found.values()):
        raise RecordingError(f"{path} has no rows of numbers. Name a text file with columns of numbers.")
    return {name: np.array(values) for name, values in found.items()}


def _read_number(cell: str, path: Path, line: int, name: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise RecordingError(
            f"{path}, line {line}: {name} is {cell.strip()!r}, which is no number. Correct the line, or name another "
            "column with --columns."
        )
    return value
