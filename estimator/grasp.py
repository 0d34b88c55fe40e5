"""One grasp's estimation: bank, evidence, decision and criteria from contact to the end."""

from copy import copy
from dataclasses import dataclass

import numpy as np

from acquisition.blocks import Flag
from config.schema import Identification as Settings
from estimator.bank import LOG_ALPHA, LOG_DAMPING, Bank, BankState, Contact
from estimator.blocks import GraspRecord, finite
from estimator.criteria import ForceErrors
from estimator.decision import UNDECIDED, UNKNOWN, Decision
from estimator.evidence import Evidence
from estimator.model import force_curve

ENCODER_SLIPS, SATURATED = Flag.ENCODER_SLIPS.value, Flag.SATURATED.value
UNFELT_FORCE_N = 0.005  # scale of what presses before the back-dated rise of the force begins; see decision 4
KEPT_STEPS = 100  # calls of `take`, 0.5 s: how far back the jaws may turn out to have been shut
LOST_ALLOWED = 5  # samples that may be missing in a grasp


@dataclass(frozen=True, slots=True)
class _Kept:
    """What was known before the samples from `tick` on were taken."""

    tick: int
    bank: BankState
    decision: Decision
    probabilities: np.ndarray
    best: int
    taken: int


class GraspEstimation:
    """Follows one grasp; `take` its samples in steps, `finish` for its record."""

    def __init__(
        self, index: int, start_tick: int, bank: Bank, evidence: Evidence, settings: Settings, rate_hz: float
    ) -> None:
        self.index, self.start_tick = index, start_tick
        self._bank, self._evidence = bank, evidence
        self.names = bank.priors.names
        self.decision = Decision((*self.names, UNKNOWN), settings, rate_hz)
        self.probabilities = evidence.prior
        self.best = -1
        self.peak_n, self.peak_m = np.nan, np.nan
        self.contact_tick, self._contact_m = -1, np.nan
        self.over = False  # nothing more to learn: jaws shut, or an encoder that slips
        self.flags = 0
        self.lost_samples = 0
        self._errors = ForceErrors(len(self.names), settings.convergence_error)
        self._kept: list[_Kept] = []
        self._taken = 0

    def begin(self, sample: np.void, before_m: np.ndarray, rate_hz: float) -> None:
        """First sample in contact; `before_m` are the jaw displacements of the samples before it."""
        sensed = bool(sample["flags"] & Flag.CONTACT_SENSED)
        approach = (before_m[-1] - before_m[0]) / (len(before_m) - 1) * rate_hz if len(before_m) > 1 else 0.0
        self.contact_tick, self._contact_m = int(sample["tick"]), float(sample["jaw_displacement_m"])
        self._bank.start(
            Contact(
                float(sample["jaw_force_n"]),
                float(sample["metre_per_volt"]),
                0.0 if sensed else float(approach),
                0.0 if sensed else UNFELT_FORCE_N,
            )
        )

    def take(self, samples: np.ndarray, estimates: np.ndarray) -> None:
        """Advance over samples in contact and write their estimates; the probabilities follow at the last one."""
        self._kept.append(
            _Kept(
                int(samples["tick"][0]), self._bank.state.copy(), copy(self.decision), self.probabilities, self.best,
                self._taken,
            )
        )  # fmt: skip
        del self._kept[:-KEPT_STEPS]
        force_n = np.ascontiguousarray(samples["jaw_force_n"])
        displacement = samples["jaw_displacement_m"] - self._contact_m
        mean, variance = self._bank.advance(
            force_n, displacement, np.ascontiguousarray(samples["newton_per_volt"]),
            np.ascontiguousarray(samples["metre_per_volt"]),
        )  # fmt: skip
        self._taken += len(samples)
        parameters = np.exp(mean[:, :, LOG_ALPHA : LOG_DAMPING + 1])
        estimates["alpha_n"], estimates["beta_per_m"] = parameters[:, :, 0], parameters[:, :, 1]
        estimates["damping_kg_per_s"] = parameters[:, :, 2]
        estimates["log_sd"] = np.sqrt(variance[:, :, LOG_ALPHA : LOG_DAMPING + 1])
        estimates["force_n"] = force_curve(parameters[:, :, 0], parameters[:, :, 1], mean[:, :, 0])
        self._errors.add(estimates["force_n"], force_n)
        self.probabilities, self.best = self._evidence.probabilities()
        self.decision.update(self.probabilities, int(samples["tick"][-1]))

    def shut(self, wall_tick: int) -> None:
        """The jaws have been shut since `wall_tick`: take back what was learned from there on, and learn no more."""
        self.over = True
        if not self._kept:
            return
        last = ([kept for kept in self._kept if kept.tick <= wall_tick] or self._kept[:1])[-1]
        self._bank.state, self.decision, self._taken = last.bank, last.decision, last.taken
        self.probabilities, self.best = last.probabilities, last.best
        self._errors.truncate(self._taken)
        self._kept.clear()

    def why_invalid(self) -> str | None:
        """What speaks against believing this grasp, or None."""
        if self.flags & ENCODER_SLIPS:
            return "encoder slips or walks"
        if self.flags & SATURATED:
            return "the strain gage is saturated"
        if self.contact_tick < 0:
            return "no contact with tissue was found"
        if self.lost_samples > LOST_ALLOWED:
            return f"{self.lost_samples} samples are missing"
        return None

    @property
    def label(self) -> str:
        """The decision, unless the grasp cannot be believed: then no tissue is named."""
        believed = self.decision.label == UNKNOWN or self.why_invalid() is None
        return self.decision.label if believed else UNDECIDED

    def named_probabilities(self) -> dict[str, float]:
        return dict(zip((*self.names, UNKNOWN), map(float, self.probabilities), strict=True))

    def time_to_decision_s(self, rate_hz: float) -> float | None:
        if self.label == UNDECIDED:
            return None
        return (self.decision.decided_tick - self.contact_tick) / rate_hz

    def criteria(self, rate_hz: float) -> tuple[dict[str, float | None], dict[str, float | None]]:
        """The paper's convergence time (s after contact) and mean force error (N) of each filter."""
        convergence = self._errors.convergence_samples() / rate_hz
        error = self._errors.mean_error_n()
        return (
            dict(zip(self.names, map(finite, convergence), strict=True)),
            dict(zip(self.names, map(finite, error), strict=True)),
        )

    def finish(self, end_tick: int, rate_hz: float) -> GraspRecord:
        """The record of the grasp that ended at `end_tick`."""
        convergence, error = self.criteria(rate_hz)
        label, probabilities = self.label, self.named_probabilities()
        parameters = [np.nan] * 3
        if self.best >= 0 and self._bank.is_believed(self.best):
            parameters = np.exp(self._bank.state.mean[self.best, LOG_ALPHA : LOG_DAMPING + 1])
        why_invalid = self.why_invalid()
        return GraspRecord(
            index=self.index,
            start_s=self.start_tick / rate_hz,
            contact_s=self.contact_tick / rate_hz if self.contact_tick >= 0 else None,
            end_s=end_tick / rate_hz,
            label=label,
            probability=probabilities.get(label),
            probabilities=probabilities,
            time_to_decision_s=self.time_to_decision_s(rate_hz),
            alpha_n=finite(parameters[0]),
            beta_per_m=finite(parameters[1]),
            damping_kg_per_s=finite(parameters[2]),
            peak_force_n=finite(self.peak_n),
            peak_displacement_m=finite(self.peak_m),
            convergence_s=convergence,
            force_error_n=error,
            valid=why_invalid is None,
            why_invalid=why_invalid,
        )
