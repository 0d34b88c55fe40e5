"""Predict the features of another recording of a tissue, from recordings of that tissue and of others.

The centers of recordings are a Gaussian process over tissue and log ramp. Tissues differ widely. Another ramp changes
all tissues alike, and each a little by itself. Each recording has its own deviation. All these terms have the same
covariance over the features, up to a scale, so a prediction is a weighted mean of centers.
"""

from dataclasses import dataclass

import numpy as np

from estimator.loading.constants import (
    BETWEEN_CORRELATION,
    BETWEEN_RANGE,
    BETWEEN_SD,
    RATE_LENGTH_LOG,
    RATE_SCALE,
    RATE_TISSUE_SCALE,
    SESSION_SCALE,
    SESSION_SCALE_WEIGHT,
    TISSUE_SCALE,
)

SAME_RAMP_TOLERANCE_LOG = 0.2  # ramps that differ by less count as equal


def between_covariance() -> np.ndarray:
    """Return the covariance (F, F) of the features that all differences between recordings share, up to a scale."""
    at = np.arange(len(BETWEEN_SD))
    fall = BETWEEN_CORRELATION * np.exp(-np.abs(np.subtract.outer(at, at)) / BETWEEN_RANGE)
    np.fill_diagonal(fall, 1.0)
    return np.outer(BETWEEN_SD, BETWEEN_SD) * fall


@dataclass(frozen=True, slots=True)
class RecordingCenters:
    """Centers of the R recordings of a learned library."""

    tissue_indices: np.ndarray  # (R,) index of the tissue
    log_ramps: np.ndarray  # (R,)
    centers: np.ndarray  # (R, F)
    session_scale: float

    def predict_center(self, tissue: int, ramp_log: float) -> tuple[np.ndarray, float]:
        """Return the predicted center (F,) of a new recording, and its variance in units of `between_covariance`.

        `ramp_log` is the natural logarithm of the command's rate in V/s.
        """
        same, near = (
            np.equal.outer(self.tissue_indices, self.tissue_indices),
            _compute_ramp_kernel(self.log_ramps, self.log_ramps),
        )
        among = RATE_SCALE**2 * near + same * (TISSUE_SCALE**2 + RATE_TISSUE_SCALE**2 * near)
        np.fill_diagonal(among, among.diagonal() + self.session_scale**2)
        near_new = _compute_ramp_kernel(self.log_ramps, np.array([ramp_log]))[:, 0]
        own = self.tissue_indices == tissue
        to_new = RATE_SCALE**2 * near_new + own * (TISSUE_SCALE**2 + RATE_TISSUE_SCALE**2 * near_new)
        information = np.linalg.inv(among)
        level = (information @ self.centers).sum(axis=0) / information.sum()
        weight = to_new @ information
        variance = RATE_SCALE**2 + RATE_TISSUE_SCALE**2 + TISSUE_SCALE**2 - weight @ to_new
        variance += (1.0 - weight.sum()) ** 2 / information.sum() + self.session_scale**2
        return level + weight @ (self.centers - level), float(variance)


def _compute_ramp_kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * (np.subtract.outer(a, b) / RATE_LENGTH_LOG) ** 2)


def estimate_session_scale(tissue: np.ndarray, ramp_log: np.ndarray, centre: np.ndarray) -> float:
    """Return the scale of the deviation between recordings, from a prior and pairs of one tissue at equal ramps."""
    information = np.linalg.inv(between_covariance())
    weight, total = SESSION_SCALE_WEIGHT, SESSION_SCALE_WEIGHT * SESSION_SCALE**2
    for name in np.unique(tissue):
        own = np.flatnonzero(tissue == name)
        for i, first in enumerate(own):
            for second in own[i + 1 :]:
                if abs(ramp_log[first] - ramp_log[second]) < SAME_RAMP_TOLERANCE_LOG:
                    off = centre[first] - centre[second]
                    total += float(off @ information @ off) / (2 * len(off)) / (len(own) - 1)
                    weight += 1.0 / (len(own) - 1)
    return float(np.sqrt(total / weight))
