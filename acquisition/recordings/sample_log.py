"""The interface of recordings by other programs, which hold samples but no calibration, no run and no estimates."""

from pathlib import Path
from typing import Protocol

import numpy as np


class SampleLog(Protocol):
    """Samples that another program recorded, in the tool's units."""

    @property
    def path(self) -> Path:
        """The file."""
        ...

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was converted or left out, in words."""
        ...

    @property
    def ticks(self) -> np.ndarray:
        """Times of the samples in sample periods of the tool's board since the first one, (n,), rising."""
        ...

    @property
    def signals(self) -> dict[str, np.ndarray]:
        """The recorded sensor signals by name, (n,) each, in the units of the table of signals."""
        ...

    def find_start_ns(self) -> tuple[int | None, str]:
        """Return the time of the first sample, ns since 1970, and its description; None if the file says no time.

        Raises:
            RecordingError: the time in the file cannot be read.
        """
        ...
