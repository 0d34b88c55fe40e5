"""The class SpotTracker, which gives spot verdicts: one answer from several grasps on one place of one organ.

Grasps on one spot share its deviation from the tissue. So a further grasp on a spot tells only of the spot; multiplying
the grasps' likelihoods as if they were independent would soon be sure of what one spot cannot tell.
"""

import numpy as np

from config.schema import IdentificationSettings
from estimator.decision import NO_ANSWER, UNDECIDED
from estimator.estimate_block import SpotVerdict
from estimator.evidence import BankEvidence, GraspLikelihood
from estimator.grasp_estimation import GraspEstimator
from estimator.loading.learned_evidence import LearnedEvidence, LearnedGrasp
from estimator.loading.loading_curve import ObservedFeatures
from estimator.loading.robust_covariance import compute_robust_mean


class BankSpot:
    """Evidence of the filter bank from the grasps on one spot."""

    def __init__(self, evidence: BankEvidence) -> None:
        self._evidence = evidence
        self._grasps: list[GraspLikelihood] = []

    def append(self, grasp: GraspLikelihood) -> bool:
        """Add a grasp; return whether it is evidence."""
        is_evidence = bool(np.isfinite(grasp.log_weight).any())
        if is_evidence:
            self._grasps.append(grasp)
        return is_evidence

    def probabilities(self) -> np.ndarray:
        return self._evidence.combine_grasps(self._grasps)


class LearnedSpot:
    """Evidence of a learned library from the grasps on one spot: that of their mean loading curve.

    The spot's first grasp counts only until there is another one, because its tissue is not preconditioned.
    """

    def __init__(self, evidence: LearnedEvidence) -> None:
        self._evidence = evidence
        self._first: LearnedGrasp | None = None
        self._features: list[np.ndarray] = []
        self._log_ramps: list[float] = []

    def append(self, grasp: LearnedGrasp) -> bool:
        """Add a grasp; return whether it is evidence."""
        observed = grasp.loading_curve.observe_features()
        if grasp.is_first:
            self._first = grasp
            return bool(np.isfinite(observed.features).any())
        is_whole = bool(np.isfinite(observed.features).all())
        if is_whole:
            self._features.append(observed.features)
            self._log_ramps.append(observed.ramp_log)
        return is_whole

    def probabilities(self) -> np.ndarray:
        if not self._features:
            return self._evidence.prior if self._first is None else self._first.probabilities
        mean, grasps = compute_robust_mean(np.array(self._features), self._evidence.grasp_covariance)
        predictions = self._evidence.predict_features(float(np.median(self._log_ramps)), first=False)
        observed = ObservedFeatures(mean, np.zeros_like(mean), 0.0)
        return self._evidence.compute_posterior(observed, predictions, grasps)


class SpotTracker:
    """Tracker of the spots of one source, and of their verdicts.

    A new spot begins by request, or after the jaws were open for longer than `new_spot_after_s`. A grasp that is under
    way then belongs to the old spot.
    """

    def __init__(
        self,
        evidence: BankEvidence | LearnedEvidence,
        names: tuple[str, ...],
        settings: IdentificationSettings,
        rate_hz: float,
        first_tick: int = 0,
    ) -> None:
        """`names`: the library's tissues, then `unknown`. The first spot begins at `first_tick`."""
        self._source, self._names, self._settings, self._rate_hz = evidence, names, settings, rate_hz
        self._index, self._began_tick = 0, 0
        self._requested = False  # during a grasp, which belongs to the old spot
        self._last_end_tick: int | None = None
        self._all: tuple[SpotVerdict, ...] = ()
        self._verdicts: dict[int, SpotVerdict] = {}  # by the spot's index
        self._begin(first_tick)

    def _begin(self, tick: int) -> None:
        self._index += 1
        self._began_tick = tick
        source = self._source
        self._evidence = LearnedSpot(source) if isinstance(source, LearnedEvidence) else BankSpot(source)
        self._grasps: list[int] = []  # those that the verdict is from
        self._finished, self._faults = 0, 0
        self.dose_n_s = 0.0  # of the finished grasps on this spot

    @property
    def is_new(self) -> bool:
        """Whether no grasp on this spot has finished."""
        return self._finished == 0

    def request(self, tick: int, *, in_grasp: bool) -> None:
        """Begin a new spot at `tick`, or after the grasp under way."""
        if in_grasp:
            self._requested = True
        elif not self.is_new:
            self._begin(tick)
            self._update_verdict()

    def on_grasp_start(self, tick: int) -> None:
        """Begin a new spot if the jaws were open for long enough before this grasp."""
        pause_ticks = round(self._settings.new_spot_after_s * self._rate_hz)
        if not self.is_new and self._last_end_tick is not None and tick - self._last_end_tick > pause_ticks:
            self._begin(self._last_end_tick + pause_ticks)

    def append(self, grasp: GraspEstimator, end_tick: int) -> None:
        """Add a grasp that ended at `end_tick` to the spot."""
        self._finished += 1
        self._last_end_tick = end_tick
        self._faults += grasp.label == NO_ANSWER
        self.dose_n_s += grasp.dose_n_s
        found = grasp.measure_likelihood()
        if found is not None and self._append_evidence(found):
            self._grasps.append(grasp.index)
        self._update_verdict()
        if self._requested:
            self._requested = False
            self._begin(end_tick)
            self._update_verdict()

    def _append_evidence(self, found: GraspLikelihood | LearnedGrasp) -> bool:
        """Return whether the grasp is evidence for its spot."""
        if isinstance(found, GraspLikelihood):
            assert isinstance(self._evidence, BankSpot)
            return self._evidence.append(found)
        assert isinstance(self._evidence, LearnedSpot)
        return self._evidence.append(found)

    @property
    def verdicts(self) -> tuple[SpotVerdict, ...]:
        """The verdicts so far, one for each spot in order; the last one may be of a spot without a grasp yet."""
        return self._all

    def _update_verdict(self) -> None:
        self._verdicts[self._index] = self._build_verdict()
        self._all = tuple(self._verdicts.values())

    def _build_verdict(self) -> SpotVerdict:
        """Return the verdict; *undecided* below the probability that a name needs."""
        probabilities = self._evidence.probabilities()
        top = int(np.argmax(probabilities))
        is_sure = bool(self._grasps) and probabilities[top] >= self._settings.decide_at
        label = self._names[top] if is_sure else UNDECIDED
        if self._faults and not self._grasps:
            label = NO_ANSWER
        by_name = dict(zip(self._names, map(float, probabilities), strict=True))
        return SpotVerdict(
            index=self._index,
            grasps=tuple(self._grasps),
            label=label,
            probability=by_name.get(label),
            probabilities=by_name,
            began_s=self._began_tick / self._rate_hz,
            dose_n_s=self.dose_n_s,
        )
