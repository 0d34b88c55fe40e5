"""Long signals thinned for a page: each point pair is the least and the greatest of the samples it stands for."""

import base64
from dataclasses import dataclass
from math import ceil

import numpy as np

NO_VALUE = 65535  # of a packed channel
STEPS = NO_VALUE - 1


@dataclass(frozen=True, slots=True)
class Grid:
    """Where the points of a page's trace lie in time."""

    start_tick: int
    ticks: int  # from the first sample to the last
    stretch: int  # samples that a pair of points stands for; 1: each sample is a point

    @classmethod
    def over(cls, ticks: np.ndarray, most_points: int) -> "Grid":
        """For samples at rising `ticks`, with at most so many points, two at least."""
        if not len(ticks):
            return cls(0, 0, 1)
        span = int(ticks[-1] - ticks[0]) + 1
        return cls(int(ticks[0]), span, 1 if span <= most_points else ceil(span / (most_points // 2)))

    @property
    def step(self) -> float:
        """Ticks from one point to the next."""
        return 1.0 if self.stretch == 1 else self.stretch / 2

    @property
    def points(self) -> int:
        return self.ticks if self.stretch == 1 else 2 * ceil(self.ticks / self.stretch)

    def at(self) -> np.ndarray:
        """Ticks of the points, (points,)."""
        return self.start_tick + (np.arange(self.points) + (0.0 if self.stretch == 1 else 0.5)) * self.step

    def thin(self, ticks: np.ndarray, values: np.ndarray) -> np.ndarray:
        """`values` (n,) at `ticks` (n,) as (points,): pairs of least and greatest, in the order in which they lead on.

        NaN where no sample has a value.
        """
        padded = np.full(self.ticks if self.stretch == 1 else self.points // 2 * self.stretch, np.nan, np.float32)
        padded[ticks - self.start_tick] = values
        if self.stretch == 1:
            return padded
        stretches = padded.reshape(-1, self.stretch)
        least, greatest = np.fmin.reduce(stretches, axis=1), np.fmax.reduce(stretches, axis=1)
        half = self.stretch // 2
        with np.errstate(invalid="ignore"):
            falls = np.fmax.reduce(stretches[:, :half], axis=1) > np.fmax.reduce(stretches[:, half:], axis=1)
        return np.where(falls, [greatest, least], [least, greatest]).T.ravel()


def pack(values: np.ndarray) -> tuple[str, float, float]:
    """Values as 16-bit steps between their least and their greatest, base64, with these two; NaN is `NO_VALUE`."""
    sound = np.isfinite(values)
    if not sound.any():
        low, span = 0.0, 0.0
    else:
        low = float(values[sound].min())
        span = float(values[sound].max()) - low
    steps = np.full(len(values), NO_VALUE, "<u2")
    steps[sound] = np.rint((values[sound] - low) / (span or 1.0) * STEPS)
    return base64.b64encode(steps.tobytes()).decode(), low, low + span
