"""Functions that read LabVIEW files (`.lvm`, `.lvm.gz`): samples in the tool's order and units, and their time."""

import functools
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition.recordings import labview_time
from acquisition.recordings.labview_columns import ChannelColumn, find_columns
from acquisition.recordings.labview_header import (
    DECIMAL_EXCHANGE,
    LabviewHeader,
    Segment,
    XColumns,
    is_blank,
    read_header,
)
from acquisition.recordings.labview_text import read_lines
from acquisition.signal_table import find_wired_inputs
from config.errors import RecordingError
from config.schema import Tool

MAX_TIME_STEP_S = 86_400.0  # between two samples; a larger step is a wrong number
MAX_OFF_GRID = 0.01  # samples by which a time may lie beside the sample clock's
MAX_SHIFT_ERROR = 0.1  # the same of a channel beside others, whose converter samples them one after the other
MAX_RATE_ERROR = 0.01
MIN_ABSOLUTE_S = 1e8  # three years: times since 1904, not since the beginning of a log


class _Signal(NamedTuple):
    """A channel's samples: times s and values in the tool's unit, (n,) each, and the number of each one's line."""

    time_s: np.ndarray
    values: np.ndarray
    lines: np.ndarray


@dataclass(frozen=True, slots=True)
class LabviewLog:
    """The samples of a LabVIEW measurement file.

    `table` has shape (n, 2 + inputs): time s, the analog inputs that the tool has in the order of the signal table, V,
    encoder degrees. `remarks` say what was converted.
    """

    path: Path
    table: np.ndarray
    remarks: tuple[str, ...]
    _header: LabviewHeader
    _time_column: int  # of the strain gage, whose date and time count
    _tool: Tool

    @property
    def ticks(self) -> np.ndarray:
        """Times of the samples in sample periods since the first one, (n,)."""
        return np.round((self.table[:, 0] - self.table[0, 0]) * self._tool.board.sample_rate_hz).astype(np.int64)

    @property
    def signals(self) -> dict[str, np.ndarray]:
        """The recorded sensor signals by name, (n,) each, V and degrees."""
        names = [*find_wired_inputs(self._tool.channels), "encoder_deg"]
        signals = dict(zip(names, np.ascontiguousarray(self.table[:, 1:].T), strict=True))
        if position := self._tool.channels.position:
            signals["encoder_deg"] = signals["encoder_deg"] * position.degree_per_volt
        return signals

    def find_start_ns(self) -> tuple[int | None, str]:
        """Return the time of the first sample, ns since 1970 as if the log's clock showed UTC, and its description.

        It is None if the log says no date.

        Raises:
            RecordingError: the date or time cannot be read, or a recording cannot hold it; the text names the line.
        """
        segment, first_s = self._header.segments[0], float(self.table[0, 0])
        if self._header.is_absolute and first_s >= MIN_ABSOLUTE_S:
            line, source = segment.headings_line + 1, "UTC, from the times of the samples"
            start_ns = labview_time.convert_labview_seconds(first_s)
        elif base := labview_time.find_base_time(self.path, self._header, segment, self._time_column):
            line, source = base.line, base.source
            start_ns = base.time_ns + round(first_s * labview_time.NS_PER_S)
        else:
            return None, "not said"
        if not labview_time.is_recordable(start_ns):
            raise RecordingError(
                f"{self.path}, line {line}: the log began before {labview_time.MIN_YEAR} or after "
                f"{labview_time.MAX_YEAR} by this line, which a recording cannot hold. Was the clock set? Correct Date "
                "and Time in a copy of the file."
            )
        return start_ns, f"{labview_time.format_ns(start_ns)}, {source}"


def read_lvm(path: Path, tool: Tool) -> np.ndarray:
    """Return a LabVIEW measurement file's samples, (n, 2 + inputs), with the columns of `LabviewLog.table`."""
    return read_labview_log(path, tool).table


def read_labview_log(path: Path, tool: Tool) -> LabviewLog:
    """Read a LabVIEW measurement file.

    Raises:
        RecordingError: missing, not such a file, wrong columns or units, a bad line, or times that are not those of a
            sample clock; names file and line, and the column if it is one column's.
    """
    lines = read_lines(path)
    header = read_header(path, lines)
    rate_hz = tool.board.sample_rate_hz
    remarks: dict[str, None] = {}
    tables: list[tuple[Segment, np.ndarray]] = []
    time_column = 0
    for segment in header.segments:
        columns = find_columns(path, header, segment, tool)
        remarks |= dict.fromkeys(remark for column in columns for remark in column.remarks)
        time_column = time_column or columns[0].at
        if not all(is_blank(line, header.separator) for line in lines[segment.first_row : segment.end_row]):
            signals = _read_signals(path, header, segment, lines, columns)
            tables.append((segment, _join_signals(path, header, segment, columns, signals, rate_hz, remarks)))
    if not tables:
        raise RecordingError(
            f"{path}: holds no samples: line {header.segments[0].headings_line + 1} should be the first one."
        )
    table = _join_segments(path, header, tables, time_column, rate_hz)
    if header.separator != "\t":
        remarks = {f"its columns are separated by {header.separator_name}": None} | remarks
    return LabviewLog(path, table, tuple(remarks), header, time_column, tool)


def _read_signals(
    path: Path, header: LabviewHeader, segment: Segment, lines: list[str], columns: Sequence[ChannelColumn]
) -> list[_Signal]:
    """Return the signals of the columns, in their order."""
    rows = [
        (i + 1, lines[i]) for i in range(segment.first_row, segment.end_row) if not is_blank(lines[i], header.separator)
    ]
    if header.x_columns is XColumns.NO:
        _check_first_column_empty(path, header, rows)
    numbers = np.array([number for number, _ in rows])
    wanted = sorted({at for column in columns for at in (column.at, column.x_at) if at is not None})
    table = _read_numbers(header, [line for _, line in rows], wanted)
    if table is not None:
        by_column = dict(zip(wanted, table.T, strict=True))
        signals = []
        for column in columns:
            x = (
                column.x0 + column.step * np.arange(len(rows))
                if column.x_at is None
                else by_column[column.x_at] * column.x_factor
            )
            signals.append(_Signal(x, by_column[column.at] * column.factor, numbers))
        return signals
    if header.x_columns is XColumns.MULTI:  # a channel that ends before others leaves its cells empty
        return [_read_sparse_signal(path, header, rows, column) for column in columns]
    raise RecordingError(_describe_first_bad_line(path, header, rows, wanted))


def _check_first_column_empty(path: Path, header: LabviewHeader, rows: list[tuple[int, str]]) -> None:
    full = next((number for number, line in rows if line.partition(header.separator)[0].strip()), None)
    if full is not None:
        raise RecordingError(
            f"{path}, line {full}, column 1: expected an empty cell, as the header says X_Columns No; found a value. "
            "Correct the header to X_Columns One if these are times."
        )


def _read_numbers(header: LabviewHeader, body: list[str], columns: list[int]) -> np.ndarray | None:
    """Return the columns as an array of shape (n, columns), or None if a cell is no finite number."""
    text = "\n".join(body)
    if header.decimal_comma:
        text = text.translate(DECIMAL_EXCHANGE)
    try:
        table = np.loadtxt(io.StringIO(text), delimiter=header.separator, usecols=columns, ndmin=2, comments=None)
    except ValueError:
        return None
    return table if np.isfinite(table).all() else None


def _read_sparse_signal(
    path: Path, header: LabviewHeader, rows: list[tuple[int, str]], column: ChannelColumn
) -> _Signal:
    """Read a channel with its own times; rows in which both cells are empty hold no sample of it."""
    pair = [at for at in (column.x_at, column.at) if at is not None]
    kept = []
    for number, line in rows:
        cells = line.split(header.separator)
        if any(at < len(cells) and cells[at].strip() for at in pair):
            kept.append((number, line))
    table = _read_numbers(header, [line for _, line in kept], pair) if kept else None
    if table is None:
        if kept:
            raise RecordingError(_describe_first_bad_line(path, header, kept, pair))
        raise RecordingError(f"{path}, line {rows[0][0]}, column {column.at + 1}: {column.heading!r} has no samples.")
    numbers = np.array([number for number, _ in kept])
    return _Signal(table[:, 0] * column.x_factor, table[:, 1] * column.factor, numbers)


def _join_signals(
    path: Path,
    header: LabviewHeader,
    segment: Segment,
    columns: Sequence[ChannelColumn],
    signals: list[_Signal],
    rate_hz: float,
    remarks: dict[str, None],
) -> np.ndarray:
    """Return one table of the samples that all channels have, by the strain gage's times."""
    lead = signals[0]
    place = segment.line_number("Delta_X") if columns[0].x_at is None else int(lead.lines[0])
    _check_time(path, lead.time_s, lead.lines, rate_hz, place)
    _check_stated_step(path, segment, columns[0], lead.time_s)
    if header.x_columns is not XColumns.MULTI:
        return np.column_stack([lead.time_s, *(signal.values for signal in signals)])
    ticks = []
    for column, signal in zip(columns, signals, strict=True):
        time_s = lead.time_s if column.has_no_timing and len(signal.lines) == len(lead.lines) else signal.time_s
        if time_s is signal.time_s:
            _check_time(path, time_s, signal.lines, rate_hz, int(signal.lines[0]))
        off = (time_s - lead.time_s[0] + column.start_offset_s) * rate_hz
        if abs(off[0] - round(off[0])) > MAX_SHIFT_ERROR:
            raise RecordingError(
                f"{path}, line {signal.lines[0]}, column {column.at + 1}: {column.heading!r} was sampled {off[0]:.3f} "
                f"samples after {columns[0].heading!r}; expected whole samples. Both need the same sample clock."
            )
        ticks.append(np.round(off).astype(np.int64))
    if all(np.array_equal(each, ticks[0]) for each in ticks):
        return np.column_stack([lead.time_s, *(signal.values for signal in signals)])
    common = functools.reduce(np.intersect1d, ticks)
    if not len(common):
        raise RecordingError(
            f"{path}, line {segment.headings_line}: no sample has a value of every channel: their times do not overlap."
        )
    remarks[f"its channels begin or end at different times: {len(common)} samples have a value of each"] = None
    at = [np.searchsorted(each, common) for each in ticks]
    values = [signal.values[rows] for signal, rows in zip(signals, at, strict=True)]
    return np.column_stack([lead.time_s[at[0]], *values])


def _check_stated_step(path: Path, segment: Segment, column: ChannelColumn, time_s: np.ndarray) -> None:
    """Check that the header's step between samples is that of the times."""
    if column.has_no_timing or not column.step or len(time_s) < 2:
        return
    found = float(np.median(np.diff(time_s)))
    if abs(found / column.step - 1.0) > MAX_RATE_ERROR:
        raise RecordingError(
            f"{path}, line {segment.line_number('Delta_X')}, column {column.at + 1}: says {column.step:g} s between "
            "samples, "
            f"but the times advance by {found:g} s. Correct the one that is wrong."
        )


def _join_segments(
    path: Path, header: LabviewHeader, tables: list[tuple[Segment, np.ndarray]], time_column: int, rate_hz: float
) -> np.ndarray:
    """Return one table of all segments, whose times go on from segment to segment or follow from their dates."""
    first, table = tables[0]
    joined = [table]
    offset_s = 0.0
    for segment, table in tables[1:]:
        last_s, begin_s = float(joined[-1][-1, 0]), float(table[0, 0])
        if abs((begin_s + offset_s - last_s) * rate_hz - 1.0) > MAX_OFF_GRID:  # no continuation
            bases = [labview_time.find_base_time(path, header, each, time_column) for each in (first, segment)]
            if bases[0] and bases[1]:
                offset_s = (bases[1].time_ns - bases[0].time_ns) / labview_time.NS_PER_S
        step = (begin_s + offset_s - last_s) * rate_hz
        if step < 0.5 or abs(step - round(step)) > MAX_OFF_GRID:
            raise RecordingError(
                f"{path}, line {segment.end_line}: a second measurement begins here, {step:.3f} samples after the last "
                "one by its date and times; expected a whole number. Split the file."
            )
        offset_s = last_s - begin_s + round(step) / rate_hz
        joined.append(np.column_stack([table[:, 0] + offset_s, table[:, 1:]]))
    return np.concatenate(joined)


def _describe_first_bad_line(
    path: Path, header: LabviewHeader, rows: list[tuple[int, str]], columns: Sequence[int]
) -> str:
    for number, line in rows:
        cells = line.split(header.separator)
        if len(cells) <= max(columns):
            return (
                f"{path}, line {number}: expected {max(columns) + 1} columns, found {len(cells)}; "
                "the file may be cut off. Delete the line if it is the last one."
            )
        for column in columns:
            try:
                sound = np.isfinite(header.parse_number(cells[column]))
            except ValueError:
                sound = False
            if not sound:
                return (
                    f"{path}, line {number}, column {column + 1}: expected a number, found {cells[column][:40]!r}; "
                    f"{header.decimal_text}."
                )
    return f"{path}: cannot be read as a table of numbers."


def _check_time(path: Path, time_s: np.ndarray, lines: np.ndarray, rate_hz: float, place: int) -> None:
    """Check that time advances by whole samples. A forward jump is a gap and allowed; anything else is an error.

    `place` is the line that a wrong sample rate is blamed on.
    """
    with np.errstate(over="ignore"):
        steps = np.diff(time_s) * rate_hz
    usual = float(np.median(steps)) if len(steps) else 1.0
    if usual > 0 and abs(usual - 1.0) > MAX_RATE_ERROR:
        raise RecordingError(
            f"{path}, line {place}: recorded at {rate_hz / usual:.6g} samples a second; the tool file says "
            f"{rate_hz:.6g}. Name the tool file that belongs to it with --tool."
        )
    with np.errstate(invalid="ignore"):
        bad = np.flatnonzero(
            ~(np.abs(steps - np.round(steps)) <= MAX_OFF_GRID) | (steps < 0.5) | (steps > MAX_TIME_STEP_S * rate_hz)
        )
    if len(bad):
        raise RecordingError(
            f"{path}, line {lines[bad[0] + 1]}: time goes from {time_s[bad[0]]:.6f} to "
            f"{time_s[bad[0] + 1]:.6f} s; expected steps of {1 / rate_hz:g} s."
        )
