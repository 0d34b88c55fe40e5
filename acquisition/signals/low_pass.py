"""The class LowPassFilter: the paper's low-pass filter, which keeps its state from block to block."""

import numpy as np

from config.errors import ConfigurationError
from config.schema import ConditioningSettings


class LowPassFilter:
    """Causal Butterworth filter of several channels; it begins in steady state at the first sample."""

    def __init__(self, settings: ConditioningSettings, rate_hz: float) -> None:
        if settings.butterworth_cutoff_hz >= rate_hz / 2:
            raise ConfigurationError(
                f"conditioning.butterworth_cutoff_hz: {settings.butterworth_cutoff_hz:g} Hz is not below half of the "
                f"tool's {rate_hz:g} samples a second. Lower it."
            )
        from scipy import signal  # the import takes most of a second: not for processes that only import this module

        self._signal = signal
        # scipy declares no types, and this form of the call always returns a pair
        self._b, self._a = signal.butter(  # pyright: ignore[reportAssignmentType, reportGeneralTypeIssues]
            settings.butterworth_order, settings.butterworth_cutoff_hz, fs=rate_hz
        )
        self._state: np.ndarray | None = None

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Filter `values` of shape (channels, n); returns the same shape."""
        if self._state is None:
            self._state = self._signal.lfilter_zi(self._b, self._a) * values[:, :1]
        filtered, self._state = self._signal.lfilter(self._b, self._a, values, axis=-1, zi=self._state)
        return filtered
