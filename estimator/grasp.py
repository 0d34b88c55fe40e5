"""One grasp's estimation: bank, evidence, decision and criteria from contact to the end."""

from copy import copy
from dataclasses import dataclass

import numpy as np

from acquisition.blocks import Flag
from config.schema import Identification as Settings
from estimator.bank import Bank, BankState
from estimator.blocks import GraspRecord, finite
from estimator.constants import EMPTY_JAWS_M, FILLED_MARGIN_M, RELEASED_PEAK_N, RELEASED_SHARE
from estimator.criteria import ForceErrors
from estimator.decision import UNDECIDED, UNKNOWN, Decision
from estimator.evidence import Evidence
from estimator.filter import PARAMETERS, X
from estimator.identifier import bank_columns, contact_of
from estimator.learning.evidence import LearnedGrasp
from estimator.model import force_curve

ENCODER_SLIPS, SATURATED = Flag.ENCODER_SLIPS.value, Flag.SATURATED.value
KEPT_SAMPLES = 500  # how far back the jaws may turn out to have been shut
KEPT_LEAST = 10  # samples after contact at which the first step may end
LOST_ALLOWED = 5  # samples that may be missing in a grasp


@dataclass(frozen=True, slots=True)
class _Kept:
    """What was known before the samples from `tick` on were taken."""

    tick: int
    bank: BankState
    decision: Decision
    probabilities: np.ndarray
    errors: int
    pressed_m: float


class GraspEstimation:
    """Follows one grasp; `take` its samples in steps, `finish` for its record."""

    def __init__(
        self,
        index: int,
        start_tick: int,
        bank: Bank,
        evidence: Evidence,
        settings: Settings,
        rate_hz: float,
        *,
        held_before: bool = False,
        learned: LearnedGrasp | None = None,
    ) -> None:
        """`held_before`: tissue was touched when the command left zero, so that nobody knows where contact was.

        `learned`: what follows the loading curve where the library was learned; the probabilities are then its own.
        """
        self.index, self.start_tick = index, start_tick
        self._bank, self._evidence, self._rate_hz = bank, evidence, rate_hz
        self.learned = learned
        self._use_thickness = settings.use_thickness
        self.names = bank.priors.names
        self.decision = Decision((*self.names, UNKNOWN), settings, rate_hz)
        self.probabilities = evidence.prior
        self.peak_n, self.peak_m, self.peak_share = np.nan, np.nan, np.nan
        self.contact_tick, self._contact_m = -1, np.nan
        self._last_tick = -1  # of the last sample that the filters took
        self._held_before = held_before
        self._learned_steel = False
        self.over = False  # nothing more to learn: jaws shut or opening, or an encoder that slips
        self.flags = 0
        self.lost_samples = 0
        self.invalid_samples = 0  # outside the domain of the jaws' kinematics
        self._holds_nothing = False
        self._gap_m: float | None = None  # between the jaws at contact
        self._of_thickness: np.ndarray | float = 0.0
        self._errors = ForceErrors(len(self.names), settings.convergence_error)
        self._kept: list[_Kept] = []
        self._felt_n = 0.0  # largest mean force of a step, N

    def begin(
        self, sample: np.void, before_m: np.ndarray, opening_m: float | None, strain_var: float, *, sensed: bool
    ) -> None:
        """First sample in contact; `before_m` are the jaw displacements of the samples before it.

        `sensed`: a trusted touch sensor told it, and not the force. `opening_m`: the gap between the open jaws, None
        where it is not known. `strain_var`: of the strain gage now, V².
        """
        approach = 0.0
        if len(before_m) > 1 and np.isfinite(before_m).all():
            approach = (before_m[-1] - before_m[0]) / (len(before_m) - 1) * self._rate_hz
        self.contact_tick, self._contact_m = int(sample["tick"]), float(sample["jaw_displacement_m"])
        self._last_tick = self.contact_tick
        if sensed and opening_m is not None and np.isfinite(self._contact_m):
            filled = self._contact_m < FILLED_MARGIN_M  # the tissue may be thicker than the jaws open
            self._gap_m = None if filled else max(opening_m - self._contact_m, 0.0)
            if self._use_thickness:
                self._of_thickness = self._evidence.of_thickness(self._contact_m, opening_m)
        self._bank.start(contact_of(sample, float(approach), sensed=sensed), strain_var)

    def take(self, samples: np.ndarray, estimates: np.ndarray) -> None:
        """Advance over samples in contact and write their estimates; the probabilities follow at the last one."""
        columns = bank_columns(samples, self._contact_m, self._last_tick, 1.0 / self._rate_hz)
        self._last_tick = int(samples["tick"][-1])
        self._kept.append(
            _Kept(
                int(samples["tick"][0]),
                self._bank.state.copy(),
                copy(self.decision),
                self.probabilities,
                len(self._errors),
                float(columns[0, 1]),
            )
        )
        while self._kept[0].tick < self._last_tick - KEPT_SAMPLES:
            del self._kept[0]
        felt_n = float(columns[:, 0].mean())
        self._felt_n = max(self._felt_n, felt_n)
        if self._felt_n > RELEASED_PEAK_N and felt_n < RELEASED_SHARE * self._felt_n:
            self.over = True
            return
        mean, variance = self._bank.advance(columns)
        parameters = np.exp(mean[:, :, PARAMETERS])
        estimates["alpha_n"], estimates["beta_per_m"] = parameters[:, :, 0], parameters[:, :, 1]
        estimates["damping_kg_per_s"] = parameters[:, :, 2]
        estimates["log_sd"] = np.sqrt(variance[:, :, PARAMETERS])
        estimates["force_n"] = force_curve(parameters[:, :, 0], parameters[:, :, 1], mean[:, :, X])
        self._errors.add(estimates["force_n"], columns[:, 0])
        if self.learned is None:
            self.probabilities = self._evidence.probabilities(self._of_thickness)
            self.decision.update(self.probabilities, int(samples["tick"][-1]))

    def weigh_loading(self, samples: np.ndarray) -> None:
        """With a learned library: what these samples (dtype SAMPLE) of the grasp add to its loading curve."""
        if self.learned is None or self._holds_nothing:
            return
        if self.flags & ENCODER_SLIPS:
            self._hold_unknown()  # no tissue was learned with such a travel, and none can be named from it
        else:
            self.probabilities = self.learned.take(samples)
        self.decision.update(self.probabilities, int(samples["tick"][-1]))

    def shut(self, wall_tick: int, contact_tick: int) -> None:
        """The jaws have been shut since `wall_tick`: take back what was learned from there on, and learn no more."""
        self.over = True
        if not self._kept:
            if contact_tick >= 0:  # both are told at once
                self.contact_tick = contact_tick
                self._hold_nothing(wall_tick)
            return
        self._learned_steel = self._kept[0].tick > max(wall_tick, self.contact_tick + KEPT_LEAST)
        last = ([kept for kept in self._kept if kept.tick <= wall_tick] or self._kept[:1])[-1]
        self._bank.state = last.bank
        if self.learned is None:
            self.decision, self.probabilities = last.decision, last.probabilities
        self._errors.truncate(last.errors)
        self._kept.clear()
        if last.pressed_m < EMPTY_JAWS_M:
            self._hold_nothing(wall_tick)

    def _hold_nothing(self, wall_tick: int) -> None:
        """Jaw on jaw."""
        self._holds_nothing = True
        self._hold_unknown()
        self.decision.label, self.decision.decided_tick = UNKNOWN, wall_tick

    def _hold_unknown(self) -> None:
        self.probabilities = np.zeros_like(self.probabilities)
        self.probabilities[-1] = 1.0

    def why_invalid(self) -> str | None:
        """What speaks against believing this grasp, or None."""
        if self.flags & ENCODER_SLIPS:
            return "encoder slips or walks"
        if self.flags & SATURATED:
            return "the strain gage is saturated"
        if self._learned_steel and self.learned is None:
            return "the jaws were shut before it could be told"
        if self._held_before:
            return "tissue was still held from before the grasp"
        if self.contact_tick < 0:
            return "no contact with tissue was found"
        # a loading curve is measured at the handle, and needs no kinematics of the jaws
        missing = self.lost_samples + (self.invalid_samples if self.learned is None else 0)
        if missing > LOST_ALLOWED:
            return f"{missing} samples are missing"
        return None

    @property
    def label(self) -> str:
        """The decision, unless the grasp cannot be believed: then no tissue is named."""
        believed = self.decision.label == UNKNOWN or self.why_invalid() is None
        return self.decision.label if believed else UNDECIDED

    @property
    def thickness_m(self) -> float | None:
        """Of what is held, from the gap between the jaws at contact; None where that is not known or not believed."""
        unbelieved = self._held_before or self.flags & ENCODER_SLIPS
        return None if unbelieved else self._gap_m

    def named_probabilities(self) -> dict[str, float]:
        return dict(zip((*self.names, UNKNOWN), map(float, self.probabilities), strict=True))

    def time_to_decision_s(self) -> float | None:
        if self.label == UNDECIDED:
            return None
        since = self.contact_tick if self.contact_tick >= 0 else self.start_tick
        return max(self.decision.decided_tick - since, 0) / self._rate_hz

    def criteria(self) -> tuple[dict[str, float | None], dict[str, float | None]]:
        """The paper's convergence time (s after contact) and mean force error (N) of each filter."""
        convergence = self._errors.convergence_samples() / self._rate_hz
        error = self._errors.mean_error_n()
        return (
            dict(zip(self.names, map(finite, convergence), strict=True)),
            dict(zip(self.names, map(finite, error), strict=True)),
        )

    def finish(self, end_tick: int) -> GraspRecord:
        """The record of the grasp that ended at `end_tick`."""
        convergence, error = self.criteria()
        rate_hz = self._rate_hz
        label, probabilities = self.label, self.named_probabilities()
        parameters = [np.nan] * 3
        best = self._bank.best() if self.contact_tick >= 0 else -1
        if best >= 0:
            parameters = np.exp(self._bank.state.mean[best, PARAMETERS])
        why_invalid = self.why_invalid()
        return GraspRecord(
            index=self.index,
            start_s=self.start_tick / rate_hz,
            contact_s=self.contact_tick / rate_hz if self.contact_tick >= 0 else None,
            end_s=end_tick / rate_hz,
            label=label,
            probability=probabilities.get(label),
            probabilities=probabilities,
            time_to_decision_s=self.time_to_decision_s(),
            alpha_n=finite(parameters[0]),
            beta_per_m=finite(parameters[1]),
            damping_kg_per_s=finite(parameters[2]),
            peak_force_n=finite(self.peak_n),
            peak_displacement_m=finite(self.peak_m),
            convergence_s=convergence,
            force_error_n=error,
            valid=why_invalid is None,
            why_invalid=why_invalid,
            peak_share_of_limit=finite(self.peak_share),
        )
