"""The class TickGrid, which brings samples that arrive one by one to the ticks of a clock."""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

MAX_GAP_STEPS = 10.0  # steps of the clock; samples that are further apart are not interpolated
ROUNDING_S = 1e-8


class _Sample(NamedTuple):
    time_s: float
    values: np.ndarray
    arrival_s: float


class TickGrid:
    """Ticks of a clock of `rate_hz`, with values interpolated linearly between samples, but not over gaps.

    A time that goes back or jumps counts once the next one follows it. Otherwise its sample was damaged on the way, and
    is left out.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz, self._gap_s = rate_hz, MAX_GAP_STEPS / rate_hz
        self.next_tick = 0
        self._origin_s, self._last_arrival_s = 0.0, math.nan
        self._last: _Sample | None = None
        self._doubtful: _Sample | None = None
        self._pending: deque[tuple[int, np.ndarray]] = deque()

    def append(self, time_s: float, values: Sequence[float], arrival_s: float) -> None:
        """Add a sample of the device's time `time_s`, which arrived at `arrival_s` by this computer's clock."""
        sample = _Sample(time_s, np.asarray(values, float), arrival_s)
        if self._last is None or self._follows(self._last, time_s):
            self._doubtful = None
            self._accept(sample)
        elif self._doubtful is not None and self._follows(self._doubtful, time_s):
            doubtful = self._doubtful
            self.interrupt()
            self._accept(doubtful)
            self._accept(sample)
        elif time_s != self._last.time_s:  # of samples with equal times the first one counts
            self._doubtful = sample

    def interrupt(self) -> None:
        """Begin a gap before the next sample, as long as this computer's clock says."""
        self._last = self._doubtful = None

    def _follows(self, before: "_Sample", time_s: float) -> bool:
        return 0.0 < time_s - before.time_s <= self._gap_s

    def _accept(self, sample: "_Sample") -> None:
        if self._last is None:
            if math.isfinite(self._last_arrival_s):
                gap = round((sample.arrival_s - self._last_arrival_s) * self._rate_hz)
                self.next_tick += max(gap - 1, 0)
            self._origin_s = sample.time_s - self.next_tick / self._rate_hz
            self._add(sample.values)
        else:
            before, step_s = self._last, sample.time_s - self._last.time_s
            while (at_s := self._origin_s + self.next_tick / self._rate_hz) <= sample.time_s + ROUNDING_S:
                share = min(max((at_s - before.time_s) / step_s, 0.0), 1.0)
                self._add(before.values + share * (sample.values - before.values))
        self._last, self._last_arrival_s = sample, sample.arrival_s

    def _add(self, values: np.ndarray) -> None:
        self._pending.append((self.next_tick, values))
        self.next_tick += 1

    def __len__(self) -> int:
        return len(self._pending)

    def pop_consecutive(self, most: int) -> tuple[int, np.ndarray]:
        """Return the first tick and the values, (n, columns), of up to `most` ticks without a gap; n >= 1."""
        first, values = self._pending.popleft()
        rows = [values]
        while len(rows) < most and self._pending and self._pending[0][0] == first + len(rows):
            rows.append(self._pending.popleft()[1])
        return first, np.array(rows)
