"""The function that reads a recording from a table file, as `[table]` of the tool file says."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition.recordings.binary_tables import is_binary_table, read_binary_table
from acquisition.recordings.column_table import ColumnTable, Wanted
from acquisition.recordings.labview_time import NS_PER_S, format_ns, is_recordable
from acquisition.recordings.table_times import build_grid
from acquisition.recordings.text_table import read_text_table
from acquisition.table_columns import find_factors
from config.errors import RecordingError
from config.schema import Tool
from config.table_layout import TableLayout
from config.units import find_conversion_factor

MAX_DAMAGED_SHARE = 0.01
UNIX_TIME_S = (1e9, 3e9)  # 2001 to 2065: times in this range count from 1970


@dataclass(frozen=True, slots=True)
class TableLog:
    """The samples of a table file; see `SampleLog`."""

    path: Path
    ticks: np.ndarray
    signals: dict[str, np.ndarray]
    remarks: tuple[str, ...]
    _start_ns: int | None

    def find_start_ns(self) -> tuple[int | None, str]:
        """Return the time of the first sample, ns since 1970, and its description; None if the file says no time."""
        if self._start_ns is None:
            return None, "not said"
        return self._start_ns, f"{format_ns(self._start_ns)}, UTC, from the times in the file"


def read_table_log(path: Path, tool: Tool) -> TableLog:
    """Read a recording from a text (CSV, TSV, blanks; also packed by gzip), TDMS, MAT or Parquet file.

    Raises:
        RecordingError: the tool file has no `[table]` or a wrong one, or the file does not fit it; the text names the
            place in either.
    """
    layout = tool.table
    if layout is None:
        raise RecordingError(
            f"{path}: is neither an .mcap recording nor a LabVIEW log, and the tool file {tool.name!r} does not say "
            "what the columns of other files are. Add [table] to a copy of the tool file, and name it with --tool."
        )
    factors = find_factors(layout, tool)
    wanted = [each.column for each in layout.columns]
    if layout.time:
        wanted.append(layout.time.column)
    table = read_table(path, layout, wanted)
    _check_damaged(path, table)
    time_s, stated_hz = _find_times(path, table, layout)
    grid = build_grid(path, table, time_s, table.values[:, : len(factors)], tool.board.sample_rate_hz, stated_hz)
    signals = {
        column.signal: np.ascontiguousarray(values * factor * column.scale + column.offset)
        for column, factor, values in zip(layout.columns, factors, grid.values.T, strict=True)
    }
    damaged = sorted({*table.damaged.tolist(), *grid.dropped_rows})
    remarks = (*_describe_damaged(table.row_word, damaged), *grid.remarks)
    start_ns = table.start_ns
    if start_ns is None and layout.time and UNIX_TIME_S[0] <= grid.first_s < UNIX_TIME_S[1]:
        start_ns = round(grid.first_s * 1e6) * 1000
    elif start_ns is not None and not layout.time:
        start_ns += round(grid.first_s * NS_PER_S)
    if start_ns is not None and not is_recordable(start_ns):
        start_ns = None
    return TableLog(path, grid.ticks, signals, remarks, start_ns)


def read_table(path: Path, layout: TableLayout, wanted: Wanted) -> ColumnTable:
    """Read the wanted columns of a text, TDMS, MAT or Parquet file.

    Raises:
        RecordingError: the file cannot be read, or a column is missing or holds no numbers.
    """
    return read_binary_table(path, wanted) if is_binary_table(path) else read_text_table(path, layout, wanted)


def _find_times(path: Path, table: ColumnTable, layout: TableLayout) -> tuple[np.ndarray, float | None]:
    """Return the times of the rows, s, (n,), and the rate that they must have, if one is stated."""
    own_hz = 1.0 / table.step_s if table.step_s else None
    rate_hz = layout.rate_hz or own_hz
    if layout.time:
        return table.values[:, -1] * find_conversion_factor(layout.time.unit, "s"), rate_hz
    if rate_hz is None:
        raise RecordingError(
            f"{path}: says no times. Write into [table] of the tool file which column holds them (`time`), or how many "
            "samples a second there are (`rate_hz`)."
        )
    return table.positions / rate_hz, own_hz


def _check_damaged(path: Path, table: ColumnTable) -> None:
    """Check that few rows are damaged besides the first and the last one.

    Raises:
        RecordingError: more than 1 % are.
    """
    inside = np.count_nonzero((table.damaged > table.rows[0]) & (table.damaged < table.rows[-1]))
    if inside > MAX_DAMAGED_SHARE * (len(table.rows) + inside):
        raise RecordingError(
            f"{path}, {table.damage}. {len(table.damaged)} of {len(table.rows) + len(table.damaged)} {table.row_word}s "
            "are damaged, which is more than 1 %. Correct [table] of the tool file if the columns are others, or copy "
            "the file again."
        )


def _describe_damaged(row_word: str, damaged: list[int]) -> tuple[str, ...]:
    match damaged:
        case []:
            return ()
        case [one]:
            return (f"{row_word} {one} is damaged and was left out",)
        case _:
            first = damaged[0]
            return (f"{len(damaged)} {row_word}s are damaged and were left out, first {row_word} {first}",)
