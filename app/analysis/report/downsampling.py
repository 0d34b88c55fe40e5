"""The class TimeGrid, which downsamples long signals: each pair of points is the minimum and maximum of its samples."""

import base64
from dataclasses import dataclass
from math import ceil

import numpy as np

PACKED_NAN = 65535  # stands for NaN in a packed channel
PACKED_MAX = PACKED_NAN - 1


@dataclass(frozen=True, slots=True)
class TimeGrid:
    """The points in time of a downsampled signal."""

    start_tick: int
    span_ticks: int  # from the first sample to the last
    samples_per_pair: int  # 1: each sample is a point

    @classmethod
    def from_ticks(cls, ticks: np.ndarray, max_points: int) -> "TimeGrid":
        """Return a grid for samples at rising `ticks`, with at most `max_points` points (two or more)."""
        if not len(ticks):
            return cls(0, 0, 1)
        span = int(ticks[-1] - ticks[0]) + 1
        return cls(int(ticks[0]), span, 1 if span <= max_points else ceil(span / (max_points // 2)))

    @property
    def step_ticks(self) -> float:
        """Ticks from one point to the next."""
        return 1.0 if self.samples_per_pair == 1 else self.samples_per_pair / 2

    @property
    def point_count(self) -> int:
        return self.span_ticks if self.samples_per_pair == 1 else 2 * ceil(self.span_ticks / self.samples_per_pair)

    def point_ticks(self) -> np.ndarray:
        """Return the ticks of the points, (points,)."""
        return (
            self.start_tick
            + (np.arange(self.point_count) + (0.0 if self.samples_per_pair == 1 else 0.5)) * self.step_ticks
        )

    def downsample(self, ticks: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Downsample `values` (n,) at `ticks` (n,) to (points,): pairs of minimum and maximum, in their rough order.

        NaN where no sample has a value.
        """
        padded = np.full(
            self.span_ticks if self.samples_per_pair == 1 else self.point_count // 2 * self.samples_per_pair,
            np.nan,
            np.float32,
        )
        padded[ticks - self.start_tick] = values
        if self.samples_per_pair == 1:
            return padded
        stretches = padded.reshape(-1, self.samples_per_pair)
        least, greatest = np.fmin.reduce(stretches, axis=1), np.fmax.reduce(stretches, axis=1)
        half = self.samples_per_pair // 2
        with np.errstate(invalid="ignore"):
            falls = np.fmax.reduce(stretches[:, :half], axis=1) > np.fmax.reduce(stretches[:, half:], axis=1)
        return np.where(falls, [greatest, least], [least, greatest]).T.ravel()


def pack_values(values: np.ndarray) -> tuple[str, float, float]:
    """Pack values as 16-bit steps in base64, with their minimum and maximum; NaN becomes `PACKED_NAN`."""
    sound = np.isfinite(values)
    if not sound.any():
        low, span = 0.0, 0.0
    else:
        low = float(values[sound].min())
        span = float(values[sound].max()) - low
    steps = np.full(len(values), PACKED_NAN, "<u2")
    steps[sound] = np.rint((values[sound] - low) / (span or 1.0) * PACKED_MAX)
    return base64.b64encode(steps.tobytes()).decode(), low, low + span
