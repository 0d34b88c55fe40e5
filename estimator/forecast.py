"""The class ForceForecast, which forecasts when a rising force reaches a limit."""

import math

import numpy as np

SLOPE_WINDOW_S = 0.05  # window of the slope: five times the lag of drive and tissue, so that a ramp fills it
LEVEL_SAMPLES = 5  # their mean is the present force
SIGNIFICANCE_SD = 4.0  # standard deviations that make a slope a rise: noise alone reaches it once in half an hour
FORECAST_HORIZON_S = 2.0  # longest forecast: few grasps last so long


class ForceForecast:
    """Extrapolation of a straight line through the last force samples to a limit."""

    def __init__(self, rate_hz: float) -> None:
        self.window_samples = max(round(SLOPE_WINDOW_S * rate_hz), LEVEL_SAMPLES)
        at_s = (np.arange(self.window_samples) - 0.5 * (self.window_samples - 1)) / rate_hz
        self._weights = at_s / (at_s @ at_s)  # least squares: the slope is this times the forces
        self._slope_sd_per_n = 1.0 / math.sqrt(at_s @ at_s)
        self._level_age_s = 0.5 * (LEVEL_SAMPLES - 1) / rate_hz

    def forecast_time_to_limit_s(self, force_n: np.ndarray, limit_n: float, noise_sd_n: float) -> float | None:
        """Return the time from the last sample until the force reaches the limit, s; 0 if it has.

        None if the force does not rise significantly, needs more than two seconds, or a value is missing. `force_n`
        holds the last `window_samples` unfiltered forces at even intervals; `noise_sd_n` is the SD of one of them.
        """
        level_n = float(np.add.reduce(force_n[-LEVEL_SAMPLES:])) / LEVEL_SAMPLES
        if level_n >= limit_n:
            return 0.0
        slope_n_per_s = float(self._weights @ force_n)
        if not slope_n_per_s > SIGNIFICANCE_SD * noise_sd_n * self._slope_sd_per_n:  # also true for NaN
            return None
        time_s = max((limit_n - level_n) / slope_n_per_s - self._level_age_s, 0.0)
        return time_s if time_s <= FORECAST_HORIZON_S else None
