"""From a loading curve to a probability for each tissue of a learned library and for `unknown`."""

import math

import numpy as np

from config.schema import Identification, TissueLibrary, Tool
from estimator.learning.between import Recorded, between_covariance
from estimator.learning.constants import FIRST_SCALE, FREEDOM, REMEMBERED, UNKNOWN_FREEDOM, UNKNOWN_SCALE
from estimator.learning.loading import Loading, Seen

Gaussian = tuple[np.ndarray, np.ndarray]  # mean (F,), covariance (F, F)


class LearnedEvidence:
    """What a learned library makes of loading curves. Probabilities are in the library's order, `unknown` last."""

    def __init__(self, library: TissueLibrary, tool: Tool, settings: Identification) -> None:
        learned = library.learned
        if learned is None:
            raise ValueError("the library was not learned")
        rows = [(i, r) for i, t in enumerate(library.tissues.values()) if t.learned for r in t.learned.recordings]
        self._recorded = Recorded(
            tissue=np.array([i for i, _ in rows]),
            ramp_log=np.log([r.ramp_v_per_s for _, r in rows]),
            centre=np.array([r.centre for _, r in rows]),
            session_scale=learned.session_scale,
        )
        self._within = [np.array(t.learned.loading_covariance) for t in library.tissues.values() if t.learned]
        self._between = between_covariance()
        known = (1.0 - settings.prior_unknown) / len(self._within)
        self._log_prior = np.log([known] * len(self._within) + [settings.prior_unknown])
        self._peak_v = learned.usual_peak_v
        self._stretch = tool.calibration.encoder_deg_per_volt
        self._dt_s = 1.0 / tool.board.sample_rate_hz

    def begin(self, shut_before_deg: float | None, *, first: bool) -> "LearnedGrasp":
        """Follow a grasp from its start."""
        loading = Loading(self._stretch, self._peak_v, self._dt_s, shut_before_deg, first=first)
        return LearnedGrasp(self, loading, first=first)

    @property
    def prior(self) -> np.ndarray:
        """Probabilities before any data, (M + 1,)."""
        return np.exp(self._log_prior)

    def expected(self, ramp_log: float, *, first: bool) -> list[Gaussian]:
        """Of each tissue, and of unknown, what a grasp at a ramp is likely to give."""
        tissues = []
        for i, within in enumerate(self._within):
            centre, variance = self._recorded.predict(i, ramp_log)
            variance += FIRST_SCALE**2 if first else 0.0
            tissues.append((centre, within + variance * self._between))
        centres = np.array([centre for centre, _ in tissues])
        middle = centres.mean(axis=0)
        apart = (centres - middle).T @ (centres - middle) / max(len(centres) - 1, 1)
        spread = apart + np.mean([cov for _, cov in tissues], axis=0)
        return [*tissues, (middle, UNKNOWN_SCALE**2 * spread)]

    def weigh(self, seen: Seen, expected: list[Gaussian]) -> np.ndarray:
        """Posterior probabilities, (M + 1,), from what has been seen so far."""
        told = np.flatnonzero(np.isfinite(seen.features))
        if not len(told):
            return self.prior
        slope = seen.of_shut[told]
        doubts = [(math.log(share), sd_deg**2 * np.outer(slope, slope)) for share, sd_deg in REMEMBERED]
        doubts = doubts if slope.any() else [(0.0, 0.0)]
        log_weight = self._log_prior.copy()
        for i, (mean, cov) in enumerate(expected):
            freedom = UNKNOWN_FREEDOM if i == len(expected) - 1 else FREEDOM
            off, own = seen.features[told] - mean[told], cov[np.ix_(told, told)]
            log_weight[i] += np.logaddexp.reduce([s + log_student(off, own + doubt, freedom) for s, doubt in doubts])
        weight = np.exp(log_weight - log_weight.max())
        return weight / weight.sum()


class LearnedGrasp:
    """One grasp under way: its loading curve, and what that makes likely."""

    def __init__(self, evidence: LearnedEvidence, loading: Loading, *, first: bool) -> None:
        self._evidence, self.loading, self._first = evidence, loading, first
        self._expected: list[Gaussian] = []
        self._expected_at = math.nan
        self._told: np.ndarray | None = None
        self._told_from = b""

    def take(self, samples: np.ndarray) -> np.ndarray:
        """Take samples of dtype SAMPLE; returns the probabilities, (M + 1,)."""
        if self._told is not None and self.loading.over:
            return self._told
        self.loading.take(samples)
        seen = self.loading.seen()
        what = seen.features.tobytes() + seen.of_shut.tobytes()
        if self._told is not None and what == self._told_from and seen.ramp_log == self._expected_at:
            return self._told  # nothing new: most steps pass no level of force or travel
        self._told_from = what
        if seen.ramp_log != self._expected_at:
            self._expected, self._expected_at = self._evidence.expected(seen.ramp_log, first=self._first), seen.ramp_log
        self._told = self._evidence.weigh(seen, self._expected)
        return self._told


def log_student(off: np.ndarray, scale: np.ndarray, freedom: float) -> float:
    """Logarithm of the density of a multivariate Student's t at `off` (p,) from its centre, scale matrix (p, p)."""
    lower = np.linalg.cholesky(scale)
    z = np.linalg.solve(lower, off)
    p = len(off)
    constant = math.lgamma(0.5 * (freedom + p)) - math.lgamma(0.5 * freedom) - 0.5 * p * math.log(freedom * math.pi)
    return constant - float(np.log(np.diag(lower)).sum()) - 0.5 * (freedom + p) * math.log1p(float(z @ z) / freedom)
