"""Where raw samples come from: the one interface that the board and the recordings share."""

import math
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from acquisition.drivers.command_history import AppliedCommand


@dataclass(frozen=True, slots=True)
class RawBlock:
    """Consecutive raw samples as the sensors gave them, each array of shape (n,).

    `first_tick` counts samples since the source was opened, lost ones included, so that a gap is
    visible as `first_tick` running ahead; `lost_samples` says how many went missing right before.
    `limiter` holds the limiter's flags of each sample, or of all, and `limit_n` the limit that it enforced meanwhile, N
    (NaN: none); `run` says which run they belong to, if any.
    `backlog` counts the samples after these that the board had already taken when these were read: more than a few, and
    the reader lags.
    """

    first_tick: int
    t_mono_ns: int
    strain_v: np.ndarray
    encoder_deg: np.ndarray
    motor_command_v: np.ndarray
    touch_1_v: np.ndarray
    touch_2_v: np.ndarray
    lost_samples: int = 0
    limiter_flags: np.ndarray | list[int] | int = 0
    limit_n: np.ndarray | float = math.nan
    run: str = ""
    backlog: int = 0

    def __len__(self) -> int:
        return len(self.strain_v)


class SampleSource(Protocol):
    """A running tool or a recording.

    Entering it opens the device with the motor at zero; leaving it, however that happens, leaves the motor at zero.
    """

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def read_block(self) -> RawBlock | None:
        """The next block, waiting for it if need be; None at the end of a recording.

        Raises:
            ToolError: the board failed; the motor has been commanded to zero.
        """
        ...

    def write_command(self, command_v: float) -> AppliedCommand:
        """Set the motor command, V, and return from which tick on it holds. A recording ignores it."""
        ...
