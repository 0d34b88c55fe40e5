"""The function that brings samples with any times to the ticks of a board's clock."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition.recordings.column_table import ColumnTable
from config.errors import RecordingError

MAX_GAP_STEPS = 10.0  # usual steps; samples that are further apart are not interpolated
MAX_RATE_ERROR = 0.02  # of a stated rate
MAX_OFF_GRID = 0.05  # samples by which a clock's times may lie beside its ticks
MAX_LOST_SHARE = 0.02  # of a clock's samples; where more are missing, coarse times jitter
MAX_DURATION_S = 86_400.0
MIN_RATE_SHARE, MAX_RATE_SHARE = 0.1, 30.0  # rates of recordings, as shares of the board's
AVERAGED_RATE_SHARE = 1.5  # faster samples are averaged


@dataclass(frozen=True, slots=True)
class SampleGrid:
    """Ticks of the board's clock, (m,), rising, and the values at them, (m, columns).

    `first_s` is the time of tick 0; `dropped_rows` are the numbers of a first or last row that was left out; `remarks`
    say what was done.
    """

    ticks: np.ndarray
    values: np.ndarray
    first_s: float
    dropped_rows: tuple[int, ...]
    remarks: tuple[str, ...]


def build_grid(
    path: Path, table: ColumnTable, time_s: np.ndarray, values: np.ndarray, rate_hz: float, stated_hz: float | None
) -> SampleGrid:
    """Return the samples at the ticks of a clock of `rate_hz`.

    Times of such a clock are kept as they are, with their gaps. Other times are interpolated linearly, but not over
    gaps of more than ten usual steps. Of samples that are much faster, those nearest to a tick are averaged.

    A single first or last row whose time does not fit is left out: a log that begins or ends in mid-line may have a
    part of a number there.

    Args:
        path: the file, for messages.
        table: where the rows stand in the file.
        time_s: times of the rows, (n,).
        values: values of the rows, (n, columns).
        rate_hz: the sample rate of the tool's board.
        stated_hz: the rate that the times must have, if one is stated.

    Raises:
        RecordingError: time goes back, or the rate contradicts what is stated or is far from the board's.
    """
    rows = table.rows
    inner, usual_s = _find_usable_rows(time_s)
    dropped = tuple(int(row) for row in np.delete(rows, np.arange(len(rows))[inner]))
    time_s, values, rows = time_s[inner], values[inner], rows[inner]
    steps = np.diff(time_s)
    if (steps < 0).any():
        at = int(np.argmax(steps < 0))
        raise RecordingError(
            f"{path}, {table.row_word} {rows[at + 1]}: time goes back from {time_s[at]:.6f} to {time_s[at + 1]:.6f} s. "
            "Delete the line if it is damaged, or split the file there."
        )
    if not usual_s > 0:
        raise RecordingError(
            f"{path}, {table.row_word} {rows[0]}: time does not advance. Correct the column of the times in [table] of "
            "the tool file."
        )
    if time_s[-1] - time_s[0] > MAX_DURATION_S:
        raise RecordingError(
            f"{path}: spans more than {MAX_DURATION_S / 3600:.0f} hours by its times, from {time_s[0]:g} to "
            f"{time_s[-1]:g} s. Correct the unit of the times in [table] of the tool file, or split the file."
        )
    remarks = []
    if (steps == 0).any():
        count = int((steps == 0).sum())
        remarks.append(f"{count} samples have the time of the one before: samples of one time were averaged")
        time_s, values = _average_groups(time_s, values)
        steps = np.diff(time_s)
    gap_s = MAX_GAP_STEPS * usual_s
    found_hz = 1.0 / float(steps[steps <= gap_s].mean())
    _check_rate(path, found_hz, rate_hz, stated_hz)
    if gaps := int((steps > gap_s).sum()):
        remarks.append(f"its times have {gaps} gap{'s'[: gaps != 1]} of more than {MAX_GAP_STEPS:.0f} usual steps")
    exact = (time_s - time_s[0]) * rate_hz
    ticks = np.round(exact).astype(np.int64)
    if found_hz > AVERAGED_RATE_SHARE * rate_hz:
        remarks.append(f"its {found_hz:.4g} samples a second were averaged to {rate_hz:g} a second")
        averaged_ticks, values = _average_groups(ticks, values)
        return SampleGrid(averaged_ticks.astype(np.int64), values, float(time_s[0]), dropped, tuple(remarks))
    tick_steps = np.diff(ticks)
    is_clock = tick_steps.min() > 0 and (tick_steps > 1).mean() <= MAX_LOST_SHARE
    if is_clock and np.abs(exact - ticks).max() <= MAX_OFF_GRID:
        return SampleGrid(ticks, values, float(time_s[0]), dropped, tuple(remarks))
    remarks.append(f"its {found_hz:.4g} samples a second were interpolated at {rate_hz:g} a second")
    return SampleGrid(*_interpolate(time_s, values, rate_hz, gap_s), float(time_s[0]), dropped, tuple(remarks))


def _find_usable_rows(time_s: np.ndarray) -> tuple[slice, float]:
    """Return the rows without a first or last one whose time does not fit, and the usual step, s."""
    steps = np.diff(time_s)
    if not (steps > 0).any():
        return slice(None), 0.0
    usual_s = float(np.median(steps[steps > 0]))
    if len(steps) < 2:
        return slice(None), usual_s
    unfit = (steps < 0) | (steps > MAX_GAP_STEPS * usual_s)
    return slice(int(unfit[0]), len(time_s) - int(unfit[-1])), usual_s


def _average_groups(keys: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each of the rising keys once, and the mean of its rows of values."""
    begins = np.flatnonzero(np.diff(keys, prepend=-np.inf) > 0)
    counts = np.diff(begins, append=len(keys))
    return keys[begins], np.add.reduceat(values, begins, axis=0) / counts[:, None]


def _check_rate(path: Path, found_hz: float, rate_hz: float, stated_hz: float | None) -> None:
    if stated_hz and abs(found_hz / stated_hz - 1.0) > MAX_RATE_ERROR:
        raise RecordingError(
            f"{path}: has {found_hz:.4g} samples a second by its times, but {stated_hz:.4g} are stated. Correct "
            "`rate_hz` or the unit of the times in [table] of the tool file."
        )
    if not MIN_RATE_SHARE <= found_hz / rate_hz <= MAX_RATE_SHARE:
        raise RecordingError(
            f"{path}: has {found_hz:.4g} samples a second, but the tool's board {rate_hz:g}. If the unit of the times "
            f"or `rate_hz` in [table] is right, set `board.sample_rate_hz` in the tool file to {found_hz:.4g}."
        )


def _interpolate(time_s: np.ndarray, values: np.ndarray, rate_hz: float, gap_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ticks (m,) and values (m, columns), interpolated between samples that are at most `gap_s` apart."""
    ends = np.flatnonzero(np.diff(time_s) > gap_s)
    begin_ticks = np.ceil((time_s[np.r_[0, ends + 1]] - time_s[0]) * rate_hz - 1e-6).astype(np.int64)
    end_ticks = np.floor((time_s[np.r_[ends, len(time_s) - 1]] - time_s[0]) * rate_hz + 1e-6).astype(np.int64)
    pieces = [np.arange(begin, end + 1) for begin, end in zip(begin_ticks, end_ticks, strict=True)]
    ticks = np.concatenate(pieces)
    at_s = time_s[0] + ticks / rate_hz
    return ticks, np.column_stack([np.interp(at_s, time_s, column) for column in values.T])
