"""The interface SampleSource to a board or a recording: raw blocks in, motor commands out."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from acquisition.drivers.command_history import AppliedCommand


@dataclass(frozen=True, slots=True)
class RawBlock:
    """Consecutive raw samples as the sensors gave them.

    `signals` holds an array of shape (n,) for each of SENSOR_SIGNALS, by name; a signal that the tool lacks is NaN.
    `first_tick` counts samples since the source was opened, lost ones included, so that it jumps at a gap;
    `lost_samples` counts those lost right before the block. `limiter_flags` holds the limiter's flags of each sample,
    or of all, and `limit_n` the limit enforced meanwhile, N (NaN: none). `run` names the run, if any. `backlog` counts
    the later samples that the board had taken before the read: if there are more than a few, the reader lags.
    """

    first_tick: int
    t_mono_ns: int
    signals: Mapping[str, np.ndarray]
    lost_samples: int = 0
    limiter_flags: np.ndarray | list[int] | int = 0
    limit_n: np.ndarray | float = math.nan
    run: str = ""
    backlog: int = 0

    def __len__(self) -> int:
        return len(self.signals["strain_v"])


class SampleSource(Protocol):
    """A running tool or a recording.

    Entering opens the device with the motor at zero; leaving, also after an error, sets the motor to zero.
    """

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def read_block(self) -> RawBlock | None:
        """Return the next block, waiting for it if necessary; None at the end of a recording.

        Raises:
            ToolError: the board failed; the motor has been commanded to zero.
        """
        ...

    def write_command(self, command_v: float) -> AppliedCommand:
        """Set the motor command, V, and return between which ticks it takes effect. A recording ignores it."""
        ...


class LiveSource(SampleSource, Protocol):
    """A running tool. A block without samples says that none has come for a moment."""

    def set_block_samples(self, samples: int) -> None:
        """Set the number of samples that a read waits for from now on; at first it is the board's `block_samples`."""
        ...

    @property
    def silence_reason(self) -> str:
        """Why no samples come, with what to do; empty while they come, or if a failure to come is an error."""
        ...

    def reopen(self) -> None:
        """Open the device again after this process was held up; the samples meanwhile are lost.

        Raises:
            ToolError: it cannot be opened.
        """
        ...
