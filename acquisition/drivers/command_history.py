"""The class CommandHistory: the motor command of each sample, by the board's own count of samples.

A reader that lags reads samples taken under commands that have been replaced since. So each write is kept with the
ticks between which it took effect, and each sample is compared with the command of its own tick.
"""

import math
from collections import deque
from dataclasses import dataclass
from itertools import islice


@dataclass(frozen=True, slots=True)
class AppliedCommand:
    """A motor command, V: off before tick `earliest_tick`, on from tick `latest_tick` on, unknown in between."""

    command_v: float
    earliest_tick: int
    latest_tick: int


@dataclass(frozen=True, slots=True)
class CommandBounds:
    """The commands of consecutive samples, V: bounds, most likely values, and the limiter's flags."""

    low_v: list[float]
    high_v: list[float]
    likely_v: list[float]
    flags: list[int]

    def compute_deviations_v(self, readback_v: list[float]) -> list[float]:
        """Return how far each read-back is outside the bounds, V; infinite where it is not finite."""
        bounds = zip(readback_v, self.low_v, self.high_v, strict=True)
        return [max(low - v, v - high, 0.0) if math.isfinite(v) else math.inf for v, low, high in bounds]


@dataclass(frozen=True, slots=True)
class SampleCountReading:
    """A board's report of how many samples it has taken: `count`, between `requested_ns` and `answered_ns`.

    From there the count is extrapolated: 100 ppm between the clocks of board and computer are 0.1 samples a second.
    """

    rate_hz: float
    requested_ns: int
    answered_ns: int
    count: int = 0

    def min_count_at(self, at_ns: int) -> int:
        """Return the lowest possible count at `at_ns`, which is not before the answer."""
        return self.count + math.floor((at_ns - self.answered_ns) * self.rate_hz / 1e9)

    def max_count_at(self, at_ns: int) -> int:
        """Return the highest possible count at `at_ns`, which is not before the request."""
        return self.count + math.ceil((at_ns - self.requested_ns) * self.rate_hz / 1e9)


class CommandHistory:
    """History of written commands, as long as samples taken under them may still come."""

    def __init__(self) -> None:
        self._writes: deque[tuple[AppliedCommand, int]] = deque([(AppliedCommand(0.0, 0, 0), 0)])

    @property
    def last_command_v(self) -> float:
        return self._writes[-1][0].command_v

    @property
    def last_flags(self) -> int:
        return self._writes[-1][1]

    def append(self, written: AppliedCommand, flags: int) -> None:
        """Add a command; `flags` (`SampleFlag`) are the limiter's at that command."""
        before = self._writes[-1][0]
        earliest, latest = (
            max(written.earliest_tick, before.earliest_tick),
            max(written.latest_tick, before.latest_tick),
        )
        self._writes.append((AppliedCommand(written.command_v, earliest, latest), flags))

    def compute_bounds(self, first_tick: int, samples: int) -> CommandBounds:
        """Return the commands of samples from `first_tick` on; later calls must ask for later samples."""
        commands = CommandBounds([], [], [], [])
        for tick in range(first_tick, first_tick + samples):
            while len(self._writes) > 1 and self._writes[1][0].latest_tick <= tick:
                self._writes.popleft()
            likely, flags = self._writes[0]
            low_v = high_v = likely.command_v
            for written, its_flags in islice(self._writes, 1, None):
                if written.earliest_tick > tick:
                    break
                low_v, high_v = min(low_v, written.command_v), max(high_v, written.command_v)
                if (written.earliest_tick + written.latest_tick) // 2 <= tick:
                    likely, flags = written, its_flags
            commands.low_v.append(low_v)
            commands.high_v.append(high_v)
            commands.likely_v.append(likely.command_v)
            commands.flags.append(flags)
        return commands
