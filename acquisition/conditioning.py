"""The paper's low-pass filter, with its state kept from block to block."""

import numpy as np
from scipy import signal

from config.schema import Conditioning


class LowPass:
    """Causal Butterworth filter of several channels; begins in steady state at the first sample."""

    def __init__(self, settings: Conditioning, rate_hz: float) -> None:
        self._sections = signal.butter(
            settings.butterworth_order, settings.butterworth_cutoff_hz, fs=rate_hz, output="sos"
        )
        self._state: np.ndarray | None = None

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Filter `values` of shape (channels, n); returns the same shape."""
        if self._state is None:
            steady = signal.sosfilt_zi(self._sections)  # (sections, 2)
            self._state = steady[:, None, :] * values[None, :, :1]
        filtered, self._state = signal.sosfilt(self._sections, values, axis=-1, zi=self._state)
        return filtered
