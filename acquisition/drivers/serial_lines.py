"""The class SerialSource, the driver of a device without a motor that prints a line of numbers for each sample."""

import contextlib
import errno
import math
import termios
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import numpy as np
import serial
from serial.tools import list_ports

from acquisition.drivers.command_history import AppliedCommand
from acquisition.drivers.source import RawBlock
from acquisition.drivers.tick_grid import TickGrid
from acquisition.signal_table import SENSOR_SIGNALS
from acquisition.table_columns import TextFormat, find_factors
from config.errors import RefusedError, ToolError
from config.schema import Tool
from config.table_layout import DecimalMark, Separator, TableLayout
from config.units import find_conversion_factor

WAIT_S = 0.05
"""Longest wait for a byte, so that the worker answers its commands meanwhile."""
RETRY_INTERVAL_S = 0.5
SILENCE_S = 0.5
"""After so long without a byte, samples without times of their own count as lost."""
MAX_BLOCK_SAMPLES = 100
MAX_LINE_BYTES = 10_000
MAX_DAMAGED_IN_A_ROW, RETRIED_DAMAGED_IN_A_ROW = 100, 10
RATE_WINDOW_S = 5.0
MIN_RATE_SHARE, MAX_RATE_SHARE = 0.1, 1.5  # rates of a device with times of its own, as shares of the tool file's
MAX_RATE_ERROR = 0.1  # of a device without times
MIN_TICK_SHARE = 0.5  # of the ticks that pass by this computer's clock
PORT_ERRORS = (OSError, termios.error)  # what the library raises


class SerialSource:
    """A `SampleSource` on a serial port. Times that the device prints may jitter; lines without times count as ticks.

    A port that vanishes is opened again as soon as it is back. The samples in between are lost; none is invented.
    """

    def __init__(self, tool: Tool, clock: Callable[[], int] = time.monotonic_ns) -> None:
        """`clock` returns the time of a block's read, `t_mono_ns`, ns.

        Raises:
            RecordingError: `[table]` of the tool file names no column for a needed signal, or a wrong unit.
        """
        assert tool.serial is not None  # a tool of this kind has both
        assert tool.table is not None
        self._tool, self._settings, self._clock = tool, tool.serial, clock
        self._lines = _LineParser(tool, tool.table)
        self._port: serial.Serial | None = None
        self._received = b""
        self._grid = TickGrid(tool.board.sample_rate_hz)
        self._read_tick = 0  # that follows the last one read
        self._tried_at_s, self._idle_s = -math.inf, 0.0
        self._has_times = tool.table.time is not None
        self._rate_check = _RateCheck(tool, tool.table)
        self.silence_reason = ""
        self._block_samples = tool.board.block_samples
        absent = {each.name for each in SENSOR_SIGNALS} - set(self._lines.signals)
        self._absent_signals = sorted(absent)

    def set_block_samples(self, samples: int) -> None:
        """Set the number of samples that a read waits for."""
        self._block_samples = samples

    def __enter__(self) -> Self:
        self._open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def reopen(self) -> None:
        """Open the port again after this process was held up; the samples meanwhile are lost."""
        self._close()
        self._open()

    def read_block(self) -> RawBlock:
        """Return the next samples; none if none arrives for a moment.

        Raises:
            ToolError: the lines do not hold what `[table]` says, or the rate contradicts the tool file.
        """
        end_s = self._now_s() + WAIT_S
        while len(self._grid) < self._block_samples and self._now_s() < end_s:
            self._receive()
        if not len(self._grid):
            return self._build_block(self._read_tick, np.zeros((0, len(self._lines.signals))), lost=0)
        first, values = self._grid.pop_consecutive(MAX_BLOCK_SAMPLES)
        lost, self._read_tick = first - self._read_tick, first + len(values)
        return self._build_block(first, values, lost)

    def _build_block(self, first: int, values: np.ndarray, lost: int) -> RawBlock:
        signals = dict.fromkeys(self._absent_signals, np.full(len(values), np.nan))
        signals |= {name: np.ascontiguousarray(values[:, at]) for at, name in enumerate(self._lines.signals)}
        return RawBlock(first, self._clock(), signals, lost_samples=lost, backlog=len(self._grid))

    def write_command(self, command_v: float) -> AppliedCommand:
        """Accept the command zero, because there is no motor.

        Raises:
            RefusedError: it is another command.
        """
        if command_v != 0.0:
            raise RefusedError(f"The tool {self._tool.name!r} has no motor. Choose the protocol 'by_hand'.")
        return AppliedCommand(0.0, self._read_tick, self._read_tick)

    def _now_s(self) -> float:
        return self._clock() * 1e-9

    def _open(self) -> None:
        """Try to open the port; `silence_reason` says why it fails.

        Raises:
            ToolError: the port cannot be set up as the tool file says.
        """
        self._tried_at_s = self._now_s()
        settings = self._settings
        try:
            self._port = serial.Serial(settings.port, settings.baud, timeout=WAIT_S, exclusive=True)
            self._port.reset_input_buffer()
        except PORT_ERRORS as error:
            self._close()
            self.silence_reason = _describe_open_error(settings.port, error)
            return
        except ValueError as error:  # a rate that the port cannot make
            raise ToolError(f"{settings.port}: {error}. Correct `baud` under [serial] in the tool file.") from None
        self.silence_reason = f"the device at {settings.port} prints nothing: start its program"
        self._received = b""
        self._lines.skip_next()
        self._grid.interrupt()
        self._rate_check.restart()

    def _close(self) -> None:
        if self._port is not None:
            with contextlib.suppress(*PORT_ERRORS):  # it is gone
                self._port.close()
        self._port = None

    def _receive(self) -> None:
        """Receive what has arrived, or wait for it for a moment."""
        if self._port is None:
            if self._now_s() - self._tried_at_s >= RETRY_INTERVAL_S:
                self._open()
            else:
                time.sleep(WAIT_S / 2)
            return
        try:
            chunk = self._port.read(1)
            chunk += self._port.read(self._port.in_waiting)
        except PORT_ERRORS:
            self._close()
            self.silence_reason = f"{self._settings.port} is gone: plug the device in again"
            return
        if not chunk:
            self._idle_s += WAIT_S
            return
        if self._idle_s > SILENCE_S:
            self._rate_check.restart()
            if not self._has_times:
                self._grid.interrupt()
        self._idle_s = 0.0
        *lines, self._received = (self._received + chunk).split(b"\n")
        self._received = self._received[-MAX_LINE_BYTES:]
        if not lines and not len(self._grid):
            self.silence_reason = f"{self._settings.port} gives no whole lines: check `baud` under [serial]"
        now_s = self._now_s()
        for line in lines:
            if row := self._lines.parse(line):
                before = len(self._grid)
                self._grid.append(*row, now_s)
                self._rate_check.append(now_s, len(self._grid) - before)
        if len(self._grid):
            self.silence_reason = ""


class _LineParser:
    """Parser of a device's lines, as `[table]` says: time, s, and the signals' values."""

    def __init__(self, tool: Tool, layout: TableLayout) -> None:
        self.signals = [each.signal for each in layout.columns]
        self._layout = layout
        self._form: tuple[TextFormat, int] | None = None  # and the number of cells
        factors = find_factors(layout, tool)
        self._columns = [
            (each.column, factor * each.scale, each.offset)
            for each, factor in zip(layout.columns, factors, strict=True)
            if isinstance(each.column, int)
        ]
        place = layout.time.column if layout.time else 0
        self._time_column = place if isinstance(place, int) else 0
        self._highest_column = max(self._time_column, *(place for place, _, _ in self._columns))
        self._time_factor = find_conversion_factor(layout.time.unit, "s") if layout.time else math.nan
        self._step_s = 1.0 / (layout.rate_hz or tool.board.sample_rate_hz)
        self._junk = " \r\n\0" + layout.ignore_at_line_end
        self._name, self._count, self._damaged_in_a_row, self._skips = tool.name, 0, 0, True

    def skip_next(self) -> None:
        """Skip the next line, of which only the end may come."""
        self._skips = True

    def parse(self, line: bytes) -> tuple[float, list[float]] | None:
        """Return the time of a line, s, and its values, in the order of `signals`; None for a line without samples.

        Raises:
            ToolError: none of many lines in a row holds samples.
        """
        text = line.decode("utf-8", "replace").rstrip(self._junk).lstrip(" ")
        skips, self._skips = self._skips, False
        if skips or not text.strip() or text.startswith(self._layout.comment_marks):
            return None
        self._count += 1
        if row := self._parse_cells(text):
            self._damaged_in_a_row = 0
            return row
        self._damaged_in_a_row += 1
        if self._damaged_in_a_row == RETRIED_DAMAGED_IN_A_ROW:
            self._form = None  # it was found in a damaged line
        if self._damaged_in_a_row > MAX_DAMAGED_IN_A_ROW:
            raise ToolError(
                f"The lines of the serial port do not hold the columns that [table] of the tool file {self._name!r} "
                f"names; one is {text[:60]!r}. Correct the columns and the separator there, or `baud` under [serial]."
            )
        return None

    def _parse_cells(self, text: str) -> tuple[float, list[float]] | None:
        """Return the row of a line. The first sound line determines the separator and the number of cells."""
        if self._form:
            form, cell_count = self._form
            cells = form.split(text)
            return self._read_row(form, cells) if len(cells) == cell_count else None
        for separator in [self._layout.separator] if self._layout.separator else list(Separator):
            if separator is Separator.COMMA and self._layout.decimal is DecimalMark.COMMA:
                continue
            form = TextFormat(separator, self._layout.decimal)
            cells = form.split(text)
            if row := self._read_row(form, cells):
                self._form = form, len(cells)
                return row
        return None

    def _read_row(self, form: TextFormat, cells: list[str]) -> tuple[float, list[float]] | None:
        if len(cells) < self._highest_column:
            return None
        values = [form.parse(cells[place - 1]) * scale + offset for place, scale, offset in self._columns]
        time_s = self._count * self._step_s
        if self._time_column:
            time_s = form.parse(cells[self._time_column - 1]) * self._time_factor
        return (time_s, values) if all(map(math.isfinite, [time_s, *values])) else None


class _RateCheck:
    """Check that the device gives the samples a second that the tool file states."""

    def __init__(self, tool: Tool, layout: TableLayout) -> None:
        self._name, self._has_times = tool.name, layout.time is not None
        self._tick_hz = tool.board.sample_rate_hz
        self._stated_hz = self._tick_hz if layout.time else layout.rate_hz or self._tick_hz
        self.restart()

    def restart(self) -> None:
        self._begin_s, self._lines, self._ticks = math.nan, 0, 0

    def append(self, arrival_s: float, ticks: int) -> None:
        """Count a line, which gave so many ticks; check the rate after every few seconds.

        Raises:
            ToolError: it contradicts the tool file.
        """
        if math.isnan(self._begin_s):
            self._begin_s = arrival_s
            return
        self._lines, self._ticks = self._lines + 1, self._ticks + ticks
        if arrival_s - self._begin_s < RATE_WINDOW_S:
            return
        elapsed_s = arrival_s - self._begin_s
        if self._has_times and self._ticks < MIN_TICK_SHARE * elapsed_s * self._tick_hz:
            raise ToolError(
                f"The times of the device do not advance by {self._tick_hz:g} samples a second, as the tool file "
                f"{self._name!r} says. Correct the column or the unit of the times in [table] there."
            )
        # by its own times, because a device may print what it has kept meanwhile
        found_hz = self._lines * self._tick_hz / self._ticks if self._has_times else self._lines / elapsed_s
        low, high = (MIN_RATE_SHARE, MAX_RATE_SHARE) if self._has_times else (1 - MAX_RATE_ERROR, 1 + MAX_RATE_ERROR)
        if not low <= found_hz / self._stated_hz <= high:
            raise ToolError(
                f"The device gives {found_hz:.4g} lines a second, but the tool file {self._name!r} says "
                f"{self._stated_hz:g} samples. Correct `sample_rate_hz` under [board] there, or the device's program."
            )
        self.restart()


def _describe_open_error(port: str, error: Exception) -> str:
    found = ", ".join(each.device for each in list_ports.comports()) or "none"
    code = getattr(error, "errno", None)
    if code in (errno.EACCES, errno.EPERM):
        return f"{port} may not be read by this user: add the user to the group that owns it, often `dialout`"
    if code in (errno.EAGAIN, errno.EBUSY):
        return f"another program uses {port}: close it"
    return f"there is no serial port {port}: plug the device in, or correct `port` under [serial]; there is: {found}"
