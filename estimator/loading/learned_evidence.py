"""The class LearnedEvidence: probabilities of a learned library's tissues and of `unknown`, from loading curves."""

import math

import numpy as np

from config.schema import UNKNOWN_CONDITIONS, IdentificationSettings, SourceConditions, TissueLibrary, Tool
from estimator.loading.between_spots import SpotCenters, SpotPrediction, correlate_features
from estimator.loading.constants import BETWEEN_SD, FIRST_GRASP_SCALE, PREVIOUS_CLOSURE_MIXTURE
from estimator.loading.day_comparison import align_centers
from estimator.loading.loading_curve import LoadingCurve, ObservedFeatures, find_travel_scale


class LearnedEvidence:
    """Probabilities of a learned library's M tissues in its order, then of `unknown`, from loading curves."""

    def __init__(
        self,
        library: TissueLibrary,
        tool: Tool,
        settings: IdentificationSettings,
        conditions: SourceConditions = UNKNOWN_CONDITIONS,
    ) -> None:
        """`conditions`: those of the grasps that are judged; by default nothing is known of their day."""
        learned = library.learned
        if learned is None:
            raise ValueError("the library was not learned")
        self._library, self._learned = library, learned
        self.use_conditions(conditions)
        self._grasp_covariances = [
            np.array(t.learned.loading_covariance) for t in library.tissues.values() if t.learned
        ]
        self._first_grasp_covariance = FIRST_GRASP_SCALE**2 * correlate_features(BETWEEN_SD)
        unknown = max(settings.prior_unknown, learned.prior_unknown)
        known = (1.0 - unknown) / len(self._grasp_covariances)
        self._log_prior = np.log([known] * len(self._grasp_covariances) + [unknown])
        self._peak_v = learned.usual_peak_v
        self._stretch_deg_per_volt = tool.stretch_deg_per_volt
        self._dt_s, self._travel_scale = 1.0 / tool.board.sample_rate_hz, find_travel_scale(tool)
        self._is_hand_driven = tool.hand_driven is not None

    def use_conditions(self, conditions: SourceConditions) -> None:
        """Judge from now on grasps that were recorded under other conditions."""
        tissues = self._library.tissues.values()
        rows = [(i, r) for i, t in enumerate(tissues) if t.learned for r in t.learned.recordings]
        centers, self._day_variance = align_centers(conditions, [r for _, r in rows])
        self._centers = SpotCenters(
            tissue_indices=np.array([i for i, _ in rows]),
            log_ramps=np.log([r.ramp_v_per_s for _, r in rows]),
            centers=centers,
            spot_sd=np.array(self._learned.spot_sd),
            pairs=self._learned.spot_pairs,
        )

    def start_grasp(self, previous_closure_deg: float | None, *, first: bool) -> "LearnedGrasp":
        """Return the estimator of a new grasp.

        `previous_closure_deg` is the jaw closure angle of the previous grasp, None if not known; `first` marks the
        first grasp on a spot.
        """
        loading = LoadingCurve(
            self._stretch_deg_per_volt,
            self._peak_v,
            self._dt_s,
            previous_closure_deg,
            first=first,
            travel_scale=self._travel_scale,
            hand_driven=self._is_hand_driven,
        )
        return LearnedGrasp(self, loading, first=first)

    @property
    def prior(self) -> np.ndarray:
        """Prior probabilities of the tissues and of `unknown`, (M + 1,)."""
        return np.exp(self._log_prior)

    @property
    def grasp_covariance(self) -> np.ndarray:
        """Mean covariance (F, F) of grasps on one spot, over the tissues."""
        return np.mean(self._grasp_covariances, axis=0)

    def predict_features(self, ramp_log: float, *, first: bool) -> list[SpotPrediction]:
        """Return the distribution of the features on a new spot at a ramp, for each tissue and for `unknown`."""
        freedom, added = self._centers.degrees_of_freedom, np.diag(self._day_variance)
        if first:
            added = added + self._first_grasp_covariance
        centers = [self._centers.predict_center(i, ramp_log) for i in range(len(self._grasp_covariances))]
        tissues = [
            SpotPrediction(mean, cov + added, within, freedom)
            for (mean, cov), within in zip(centers, self._grasp_covariances, strict=True)
        ]
        mean, cov, freedom = self._centers.predict_other_tissue(np.array([mean for mean, _ in centers]))
        return [*tissues, SpotPrediction(mean, cov + added, self.grasp_covariance, freedom)]

    def compute_posterior(
        self, observed: ObservedFeatures, predictions: list[SpotPrediction], grasps: float = 1.0
    ) -> np.ndarray:
        """Return posterior probabilities, (M + 1,), from the features observed so far.

        With `grasps` greater than 1, the features are the mean of as many grasps on one spot. The scatter of grasps
        falls with their number, the deviation of the spot does not.
        """
        told = np.flatnonzero(np.isfinite(observed.features))
        if not len(told):
            return self.prior
        slope = observed.closure_sensitivity[told]
        doubts = [(math.log(share), sd_deg**2 * np.outer(slope, slope)) for share, sd_deg in PREVIOUS_CLOSURE_MIXTURE]
        doubts = doubts if slope.any() else [(0.0, 0.0)]
        log_weight = self._log_prior.copy()
        for i, each in enumerate(predictions):
            off = observed.features[told] - each.mean[told]
            own = (each.spot_covariance + each.grasp_covariance / grasps)[np.ix_(told, told)]
            log_weight[i] += np.logaddexp.reduce(
                [s + compute_student_log_density(off, own + doubt, each.degrees_of_freedom) for s, doubt in doubts]
            )
        weight = np.exp(log_weight - log_weight.max())
        return weight / weight.sum()


class LearnedGrasp:
    """The current grasp: its loading curve and probabilities."""

    def __init__(self, evidence: LearnedEvidence, loading: LoadingCurve, *, first: bool) -> None:
        self._evidence, self.loading_curve, self.is_first = evidence, loading, first
        self._predictions: list[SpotPrediction] = []
        self._predicted_ramp_log = math.nan
        self._probabilities: np.ndarray | None = None
        self._last_features = b""

    @property
    def prior(self) -> np.ndarray:
        """Probabilities of the tissues and of `unknown` before the grasp, (M + 1,)."""
        return self._evidence.prior

    @property
    def probabilities(self) -> np.ndarray:
        """Probabilities of the tissues and of `unknown` by the loading curve so far, (M + 1,)."""
        return self.prior if self._probabilities is None else self._probabilities

    def process(self, samples: np.ndarray) -> np.ndarray:
        """Append samples of dtype SAMPLE and return the probabilities, (M + 1,)."""
        if self._probabilities is not None and self.loading_curve.ended:
            return self._probabilities
        self.loading_curve.append(samples)
        seen = self.loading_curve.observe_features()
        what = seen.features.tobytes() + seen.closure_sensitivity.tobytes()
        if (
            self._probabilities is not None
            and what == self._last_features
            and seen.ramp_log == self._predicted_ramp_log
        ):
            return self._probabilities  # unchanged: most steps reach no further level of force or travel
        self._last_features = what
        if seen.ramp_log != self._predicted_ramp_log:
            self._predictions, self._predicted_ramp_log = (
                self._evidence.predict_features(seen.ramp_log, first=self.is_first),
                seen.ramp_log,
            )
        self._probabilities = self._evidence.compute_posterior(seen, self._predictions)
        return self._probabilities


def compute_student_log_density(off: np.ndarray, scale: np.ndarray, freedom: float) -> float:
    """Return the log density of a multivariate Student's t at `off` (p,) from its center, with scale matrix (p, p)."""
    lower = np.linalg.cholesky(scale)
    z = np.linalg.solve(lower, off)
    p = len(off)
    constant = math.lgamma(0.5 * (freedom + p)) - math.lgamma(0.5 * freedom) - 0.5 * p * math.log(freedom * math.pi)
    return constant - float(np.log(np.diag(lower)).sum()) - 0.5 * (freedom + p) * math.log1p(float(z @ z) / freedom)
