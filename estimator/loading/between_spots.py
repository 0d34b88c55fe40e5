"""The class SpotCenters, which predicts features on another spot of a tissue, and of a tissue not in the library.

The centers of spots are a Gaussian process over tissue and log ramp. Tissues differ widely. Another ramp changes all
tissues alike, and each a little by itself. Each spot has its own deviation, whose spread is learned feature by feature
from repeated spots of one tissue at one ramp.
"""

from dataclasses import dataclass, field

import numpy as np

from estimator.loading.constants import (
    BETWEEN_CORRELATION,
    BETWEEN_RANGE,
    BETWEEN_SD,
    GRASP_DEGREES_OF_FREEDOM,
    PRIOR_PAIRS,
    PRIOR_TISSUES,
    RATE_LENGTH_LOG,
    RATE_SCALE,
    RATE_TISSUE_SCALE,
    SPOT_SD,
    TISSUE_SCALE,
    TISSUE_TO_SPOT_RATIO,
)

SAME_RAMP_TOLERANCE_LOG = 0.2  # ramps that differ by less count as equal


@dataclass(frozen=True, slots=True)
class SpotPrediction:
    """Distribution of the features on a new spot.

    A spot's center is a Student's t about `mean` (F,) with scale matrix `spot_covariance` (F, F); its grasps scatter
    about the center with `grasp_covariance` (F, F).
    """

    mean: np.ndarray
    spot_covariance: np.ndarray
    grasp_covariance: np.ndarray
    degrees_of_freedom: float


def correlate_features(sd: np.ndarray) -> np.ndarray:
    """Return the covariance (F, F) of features with standard deviations `sd` (F,) and the stated correlation."""
    at = np.arange(len(sd))
    correlation = BETWEEN_CORRELATION * np.exp(-np.abs(np.subtract.outer(at, at)) / BETWEEN_RANGE)
    np.fill_diagonal(correlation, 1.0)
    return np.outer(sd, sd) * correlation


@dataclass(frozen=True, slots=True)
class SpotCenters:
    """Centers of the R spots of a learned library with M tissues."""

    tissue_indices: np.ndarray  # (R,) index of the tissue
    log_ramps: np.ndarray  # (R,)
    centers: np.ndarray  # (R, F)
    spot_sd: np.ndarray  # (F,) spread between spots of one tissue at one ramp
    pairs: float  # independent pairs of spots from which it was learned
    _information: np.ndarray = field(init=False)  # (R F, R F), of all centers together
    _level: np.ndarray = field(init=False)  # (F,), common mean of all tissues
    _level_covariance: np.ndarray = field(init=False)  # (F, F)

    def __post_init__(self) -> None:
        count, features = self.centers.shape
        near = _compute_ramp_kernel(self.log_ramps, self.log_ramps)
        same = np.equal.outer(self.tissue_indices, self.tissue_indices)
        among = RATE_SCALE**2 * near + same * (TISSUE_SCALE**2 + RATE_TISSUE_SCALE**2 * near)
        covariance = np.kron(among, correlate_features(BETWEEN_SD))
        information = np.linalg.inv(covariance + np.kron(np.eye(count), correlate_features(self.spot_sd)))
        each = np.tile(np.eye(features), (count, 1))
        level_covariance = np.linalg.inv(each.T @ information @ each)
        object.__setattr__(self, "_information", information)
        object.__setattr__(self, "_level", level_covariance @ each.T @ information @ self.centers.ravel())
        object.__setattr__(self, "_level_covariance", level_covariance)

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of the spread between spots: those of its prior and of the pairs."""
        return min(PRIOR_PAIRS + self.pairs, GRASP_DEGREES_OF_FREEDOM)

    def predict_center(self, tissue: int, ramp_log: float) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (F,) and covariance (F, F) of the center of a new spot of a tissue.

        `ramp_log` is the natural logarithm of the command's rate in V/s.
        """
        count, features = self.centers.shape
        near = _compute_ramp_kernel(self.log_ramps, np.array([ramp_log]))[:, 0]
        own = self.tissue_indices == tissue
        shared = correlate_features(BETWEEN_SD)
        to_new = np.kron(RATE_SCALE**2 * near + own * (TISSUE_SCALE**2 + RATE_TISSUE_SCALE**2 * near), shared)
        weight = to_new @ self._information  # (F, R F)
        of_level = np.eye(features) - weight.reshape(features, count, features).sum(axis=1)
        covariance = (RATE_SCALE**2 + RATE_TISSUE_SCALE**2 + TISSUE_SCALE**2) * shared - weight @ to_new.T
        covariance += of_level @ self._level_covariance @ of_level.T + correlate_features(self.spot_sd)
        mean = of_level @ self._level + weight @ self.centers.ravel()
        return mean, 0.5 * (covariance + covariance.T)

    def predict_other_tissue(self, means: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return mean, covariance and degrees of freedom of the center of a spot of a tissue that was not learned.

        Tissues are draws of one population: its spread is learned, feature by feature, from the `means` (M, F) of the
        library's tissues, with a prior worth `PRIOR_TISSUES` tissues.
        """
        count, middle = len(means), means.mean(axis=0)
        freedom = PRIOR_TISSUES + count - 1
        prior = PRIOR_TISSUES * (TISSUE_TO_SPOT_RATIO * self.spot_sd) ** 2
        variance = (prior + ((means - middle) ** 2).sum(axis=0)) / freedom
        covariance = (1 + 1 / count) * correlate_features(np.sqrt(variance)) + correlate_features(self.spot_sd)
        return middle, covariance, min(freedom, self.degrees_of_freedom)  # it is in units of the spots' spread


def _compute_ramp_kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * (np.subtract.outer(a, b) / RATE_LENGTH_LOG) ** 2)


def estimate_spot_spread(tissue: np.ndarray, log_ramps: np.ndarray, centers: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the spread between spots of one tissue at one ramp, (F,), and the number of independent pairs.

    The spread is the prior's, worth `PRIOR_PAIRS` pairs, and moves with the data feature by feature. Repeated spots
    (R centers, (R, F), of the tissues `tissue` (R,) at the ramps `log_ramps` (R,)) are pairs; k spots are k - 1 pairs.
    """
    squares, pairs = PRIOR_PAIRS * SPOT_SD**2, 0
    for group in _group_repeated(tissue, log_ramps):
        off = centers[group] - centers[group].mean(axis=0)
        squares = squares + (off**2).sum(axis=0)
        pairs += len(group) - 1
    return np.sqrt(squares / (PRIOR_PAIRS + pairs)), pairs


def _group_repeated(tissue: np.ndarray, log_ramps: np.ndarray) -> list[np.ndarray]:
    """Return the indices of spots of one tissue at one ramp, group by group."""
    groups = []
    for name in np.unique(tissue):
        rest = np.flatnonzero(tissue == name)
        while len(rest):
            same = np.abs(log_ramps[rest] - log_ramps[rest].min()) < SAME_RAMP_TOLERANCE_LOG
            groups.append(rest[same])
            rest = rest[~same]
    return groups
