"""Recordings of the lab's LabVIEW program: `.lvm`, `.lvm.gz`."""

import contextlib
import gzip
import io
import zlib
from datetime import datetime
from pathlib import Path

import numpy as np

from config.errors import RecordingError
from config.schema import Tool

HEADER_LINES = 40  # the first part of the header has at most so many
END_OF_HEADER = "***End_of_Header***"
MAX_TIME_STEP_S = 86_400.0  # between two samples; a larger step is a wrong number
MAX_TEXT_BYTES = 256 * 2**20  # text of more than an hour
MAX_LINES = 5_000_000  # each takes many times its length in memory
LINE_ENDS = "\n\r\v\f\x1c\x1d\x1e\x85\u2028\u2029"  # all characters at which Python splits lines
ENCODER_COLUMN = "Untitled"  # the lab's name for the counter channel


def read_lvm(path: Path, tool: Tool) -> np.ndarray:
    """Read a LabVIEW measurement file.

    Returns:
        Array of shape (n, 6): time s, strain V, motor command V, touch 1 V, touch 2 V, encoder degrees.

    Raises:
        RecordingError: missing, not such a file, wrong columns, a bad line, or a gap in time; names file and line.
    """
    lines = _read_lines(path)
    headings_at = _find_column_names(path, lines)
    columns = _find_columns(path, lines[headings_at], headings_at + 1, tool)
    rows = [(number, line) for number, line in enumerate(lines[headings_at + 1 :], headings_at + 2) if line.strip()]
    body = [line for _, line in rows]
    if not body:
        raise RecordingError(f"{path}: holds no samples: line {headings_at + 2} should be the first one.")
    try:
        table = np.loadtxt(io.StringIO("\n".join(body)), delimiter="\t", usecols=columns, ndmin=2, comments=None)
    except ValueError:
        raise RecordingError(_describe_first_bad_line(path, lines, headings_at, columns)) from None
    if not np.isfinite(table).all():
        raise RecordingError(_describe_first_bad_line(path, lines, headings_at, columns))
    _check_time(path, table[:, 0], [number for number, _ in rows], tool.board.sample_rate_hz)
    return table


def read_start_time(path: Path) -> datetime | None:
    """Return the local time at which a LabVIEW measurement began, or None if the file does not say it.

    Raises:
        RecordingError: the file cannot be read.
    """
    header: dict[str, str] = {}
    for line in _read_lines(path)[:HEADER_LINES]:
        name, _, value = line.partition("\t")
        if name == END_OF_HEADER:
            break
        header[name] = value.strip()
    try:
        return datetime.strptime(f"{header['Date']} {header['Time'][:15]}", "%Y/%m/%d %H:%M:%S.%f")
    except (KeyError, ValueError):
        return None


def _read_lines(path: Path) -> list[str]:
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
            content = file.read(MAX_TEXT_BYTES + 1)
        if len(content) > MAX_TEXT_BYTES:
            raise RecordingError(f"{path}: holds more than {MAX_TEXT_BYTES // 2**20} MiB of text. Split it.")
        text = _decode(path, content)
        if sum(map(text.count, LINE_ENDS)) > MAX_LINES:
            raise RecordingError(f"{path}: holds more than {MAX_LINES} lines. Split it.")
    except FileNotFoundError:
        raise RecordingError(f"{path}: there is no such file. Check the path.") from None
    except EOFError:
        raise RecordingError(f"{path}: the compressed file is cut off before its end. Copy it again.") from None
    except (gzip.BadGzipFile, zlib.error) as error:
        raise RecordingError(f"{path}: is not a sound gzip file ({error}). Copy it again.") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}).") from None
    if not text.strip():
        raise RecordingError(f"{path}: is empty; expected a LabVIEW measurement file.")
    lines = text.splitlines()
    if not text.endswith("\n") and _is_truncated(lines):
        raise RecordingError(
            f"{path}, line {len(lines)}: the file is cut off in its last number. Copy it again, or delete the line."
        )
    return lines


def _decode(path: Path, content: bytes) -> str:
    """Decode UTF-8, or cp1252 as LabVIEW on Windows writes it."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if b"\0" not in content:
            with contextlib.suppress(UnicodeDecodeError):
                return content.decode("cp1252")
        line = content[: error.start].count(b"\n") + 1
        raise RecordingError(f"{path}, line {line}: is binary; expected a LabVIEW measurement file (text).") from None


def _is_truncated(lines: list[str]) -> bool:
    """Return whether the last line has all columns, but fewer decimals in its last number than the line above."""
    if len(lines) < 2:
        return False
    above, last = (line.strip().split("\t") for line in lines[-2:])
    return len(last) == len(above) and len(last[-1].partition(".")[2]) < len(above[-1].partition(".")[2])


def _find_column_names(path: Path, lines: list[str]) -> int:
    """Return the index of the line with the column names, the one after the second end of header."""
    if not lines[0].startswith("LabVIEW Measurement"):
        raise RecordingError(f"{path}, line 1: expected 'LabVIEW Measurement', found {lines[0][:40]!r}.")
    ends = [i for i, line in enumerate(lines) if line.startswith(END_OF_HEADER)]
    if len(ends) < 2 or ends[1] + 1 >= len(lines):
        raise RecordingError(
            f"{path}, line {len(lines)}: the file ends inside its header; expected two lines {END_OF_HEADER!r} "
            "and then the column names."
        )
    if len(ends) > 2:
        raise RecordingError(
            f"{path}, line {ends[2] + 1}: a second measurement begins here; a file may hold one. Split it."
        )
    return ends[1] + 1


def _find_columns(path: Path, headings: str, line: int, tool: Tool) -> list[int]:
    """Return the column indices in the order time, strain, command, touch 1, touch 2, encoder."""
    names = headings.split("\t")
    channels, device = tool.channels, tool.board.device
    analog = [channels.strain, channels.motor_command_readback, *channels.touch]
    wanted = ["X_Value", *(f"{device}/{channel}" for channel in analog), ENCODER_COLUMN]
    missing = [name for name in wanted if name not in names]
    if missing:
        raise RecordingError(
            f"{path}, line {line}: column {', '.join(map(repr, missing))} is missing; found "
            f"{', '.join(name for name in names if name)}. The tool file {tool.name!r} names the channels."
        )
    return [names.index(name) for name in wanted]


def _describe_first_bad_line(path: Path, lines: list[str], headings_at: int, columns: list[int]) -> str:
    for i, line in enumerate(lines[headings_at + 1 :], headings_at + 2):
        if not line.strip():
            continue
        cells = line.split("\t")
        if len(cells) <= max(columns):
            return (
                f"{path}, line {i}: expected {max(columns) + 1} columns, found {len(cells)}; "
                "the file may be cut off. Delete the line if it is the last one."
            )
        for column in columns:
            try:
                sound = np.isfinite(float(cells[column]))
            except ValueError:
                sound = False
            if not sound:
                return f"{path}, line {i}, column {column + 1}: expected a number, found {cells[column][:40]!r}."
    return f"{path}: cannot be read as a table of numbers."


def _check_time(path: Path, time_s: np.ndarray, line_numbers: list[int], rate_hz: float) -> None:
    """Check that time advances by whole samples. A forward jump is a gap and allowed; anything else is an error."""
    with np.errstate(over="ignore"):
        steps = np.diff(time_s) * rate_hz
    usual = float(np.median(steps)) if len(steps) else 1.0
    if usual > 1.5:
        raise RecordingError(
            f"{path}, line {line_numbers[0]}: recorded at {rate_hz / usual:.0f} samples a second; the tool file says "
            f"{rate_hz:.0f}. Name the tool file that belongs to it with --tool."
        )
    with np.errstate(invalid="ignore"):
        bad = np.flatnonzero(
            ~(np.abs(steps - np.round(steps)) <= 0.01) | (steps < 0.5) | (steps > MAX_TIME_STEP_S * rate_hz)
        )
    if len(bad):
        raise RecordingError(
            f"{path}, line {line_numbers[bad[0] + 1]}: time goes from {time_s[bad[0]]:.6f} to "
            f"{time_s[bad[0] + 1]:.6f} s; expected steps of {1 / rate_hz:g} s."
        )
