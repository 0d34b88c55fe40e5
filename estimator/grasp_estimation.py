"""The class GraspEstimator: bank, evidence, decision and criteria of one grasp, from contact to its end."""

from copy import copy
from dataclasses import dataclass

import numpy as np

from acquisition.sample_block import SampleFlag
from config.schema import IdentificationSettings as Settings
from estimator.constants import (
    DIVERGED_FORCE_N,
    DIVERGED_FORCE_RATIO,
    EMPTY_JAWS_TRAVEL_M,
    FILLED_JAWS_MARGIN_M,
    JAW_OPENING_SHARE,
    MIN_PEAK_BEFORE_OPENING_N,
    NIS_DIVERGED,
)
from estimator.criteria import ForceErrors
from estimator.decision import NO_ANSWER, NOT_NAMED, UNDECIDED, UNKNOWN, Decision
from estimator.estimate_block import GraspRecord, finite_or_none
from estimator.evidence import BankEvidence, GraspLikelihood
from estimator.filter_bank import BankState, FilterBank, bank_columns, build_contact_start
from estimator.force_alarms import Priority
from estimator.kalman_filter import PARAMETERS, X
from estimator.loading.learned_evidence import LearnedGrasp
from estimator.tissue_model import elastic_force_array

ENCODER_SLIPS, SATURATED = SampleFlag.ENCODER_SLIPS.value, SampleFlag.SATURATED.value
LIMITED = SampleFlag.LIMITED.value
CHECKPOINT_SAMPLES = 500  # jaw closure may be detected this many samples late
MIN_CHECKPOINT_SAMPLES = 10  # the first step may end this many samples after contact
PARAMETER_NAMES = ("alpha", "beta", "d")
MAX_MISSING_SAMPLES = 5  # a valid grasp misses at most this many samples


@dataclass(frozen=True, slots=True)
class _Checkpoint:
    """The grasp's state before the samples from `tick` on were processed."""

    tick: int
    bank: BankState
    decision: Decision
    probabilities: np.ndarray
    error_count: int
    displacement_m: float


class GraspEstimator:
    """Estimator of one grasp. Call `process` with its samples in steps, and `finish` for its record."""

    def __init__(
        self,
        index: int,
        start_tick: int,
        bank: FilterBank,
        evidence: BankEvidence,
        settings: Settings,
        rate_hz: float,
        *,
        in_contact_before: bool = False,
        learned_grasp: LearnedGrasp | None = None,
    ) -> None:
        """Start the estimation of a grasp.

        Args:
            in_contact_before: the jaws touched tissue when the command left zero, so the place of contact is not known.
            learned_grasp: loading-curve estimator of a learned library; the probabilities then come from it.
        """
        self.index, self.start_tick = index, start_tick
        self._bank, self._evidence, self._rate_hz = bank, evidence, rate_hz
        self.learned_grasp = learned_grasp
        self._use_thickness = settings.use_thickness
        self.names = bank.priors.names
        self.decision = Decision((*self.names, UNKNOWN), settings, rate_hz)
        self.probabilities = evidence.prior
        self.peak_force_n, self.peak_displacement_m, self.peak_share_of_limit = np.nan, np.nan, np.nan
        self.dose_n_s = 0.0  # displayed force over the time in contact
        self.has_dose = False
        self._samples_above: dict[Priority, int] = dict.fromkeys(Priority, 0)
        self.contact_tick, self._contact_m = -1, np.nan
        self._last_tick = -1  # of the last sample that the filters processed
        self._in_contact_before = in_contact_before
        self._learned_past_jaw_closure = False
        self.learning_ended = False  # the jaws are shut or opening, or the encoder slips
        self.flags = 0
        self.lost_samples = 0
        self.invalid_samples = 0  # outside the domain of the jaws' kinematics
        self._jaws_empty = False
        self._gap_m: float | None = None  # between the jaws at contact
        self._thickness_log_likelihood: np.ndarray | float = 0.0
        self._errors = ForceErrors(len(self.names), settings.convergence_error)
        self._checkpoints: list[_Checkpoint] = []
        self._max_force_n = 0.0  # largest mean force of a step
        self._peak_sample_n = 0.0  # largest force of a sample in contact
        self.recent_nis = np.full(len(self.names), np.nan)  # of each tissue's likelier filter

    def on_contact(
        self, sample: np.void, before_m: np.ndarray, opening_m: float | None, strain_var: float, *, contact_sensed: bool
    ) -> None:
        """Start the filters at the first sample in contact.

        Args:
            sample: the sample, dtype SAMPLE.
            before_m: jaw displacements of the samples before it, m.
            opening_m: gap between the open jaws, m; None if not known.
            strain_var: present variance of the strain gage, V².
            contact_sensed: a trusted touch sensor detected contact, not the force.
        """
        approach = 0.0
        if len(before_m) > 1 and np.isfinite(before_m).all():
            approach = (before_m[-1] - before_m[0]) / (len(before_m) - 1) * self._rate_hz
        self.contact_tick, self._contact_m = int(sample["tick"]), float(sample["jaw_displacement_m"])
        self._last_tick = self.contact_tick
        if contact_sensed and opening_m is not None and np.isfinite(self._contact_m):
            filled = self._contact_m < FILLED_JAWS_MARGIN_M  # the tissue may be thicker than the jaws open
            self._gap_m = None if filled else max(opening_m - self._contact_m, 0.0)
            if self._use_thickness:
                self._thickness_log_likelihood = self._evidence.compute_thickness_log_likelihood(
                    self._contact_m, opening_m
                )
        self._bank.start(build_contact_start(sample, float(approach), contact_sensed=contact_sensed), strain_var)

    def process(self, samples: np.ndarray, estimates: np.ndarray) -> None:
        """Advance the filters over samples in contact, write their estimates, and update the probabilities."""
        columns = bank_columns(samples, self._contact_m, self._last_tick, 1.0 / self._rate_hz)
        self._last_tick = int(samples["tick"][-1])
        self._checkpoints.append(
            _Checkpoint(
                int(samples["tick"][0]),
                self._bank.state.copy(),
                copy(self.decision),
                self.probabilities,
                len(self._errors),
                float(columns[0, 1]),
            )
        )
        while self._checkpoints[0].tick < self._last_tick - CHECKPOINT_SAMPLES:
            del self._checkpoints[0]
        felt_n = float(columns[:, 0].mean())
        self._max_force_n = max(self._max_force_n, felt_n)
        if self._max_force_n > MIN_PEAK_BEFORE_OPENING_N and felt_n < JAW_OPENING_SHARE * self._max_force_n:
            self.learning_ended = True
            return
        mean, variance = self._bank.advance(columns)
        parameters = np.exp(mean[:, :, PARAMETERS])
        estimates["alpha_n"], estimates["beta_per_m"] = parameters[:, :, 0], parameters[:, :, 1]
        estimates["damping_kg_per_s"] = parameters[:, :, 2]
        estimates["log_sd"] = np.sqrt(variance[:, :, PARAMETERS])
        estimates["force_n"] = elastic_force_array(parameters[:, :, 0], parameters[:, :, 1], mean[:, :, X])
        self._peak_sample_n = max(self._peak_sample_n, float(columns[:, 0].max()))
        diverged = estimates["force_n"] > DIVERGED_FORCE_RATIO * self._peak_sample_n + DIVERGED_FORCE_N
        for name in ("force_n", "alpha_n", "beta_per_m", "damping_kg_per_s", "log_sd"):
            estimates[name][diverged] = np.nan
        nis = self._bank.compute_recent_nis()
        self.recent_nis = np.where(diverged[-1], np.fmax(nis, NIS_DIVERGED), nis)
        estimates["nis"] = self.recent_nis
        self._errors.append(estimates["force_n"], columns[:, 0])
        if self.learned_grasp is None:
            self.probabilities = self._evidence.probabilities(self._thickness_log_likelihood)
            self.decision.update(self.probabilities, int(samples["tick"][-1]))

    def update_loading_curve(self, samples: np.ndarray) -> None:
        """Add samples (dtype SAMPLE) to the loading curve and update the probabilities, with a learned library only."""
        if self.learned_grasp is None or self._jaws_empty:
            return
        if self.flags & ENCODER_SLIPS:
            self.probabilities = self.learned_grasp.prior  # with a slipping encoder the travel is no evidence
            return
        self.probabilities = self.learned_grasp.process(samples)
        complete = self.learned_grasp.loading_curve.ended
        self.decision.update(self.probabilities, int(samples["tick"][-1]), complete=complete)

    def add_dose(self, samples: np.ndarray) -> None:
        """Add the force of samples in contact (dtype SAMPLE) to the dose; below zero or missing, it counts as zero."""
        self.dose_n_s += float(np.fmax(samples["jaw_force_filtered_n"], 0.0).sum()) / self._rate_hz
        self.has_dose = True

    def add_time_above(self, exceeded: list[Priority], samples: int) -> None:
        """Add the time of a step to each warning's share that its force has reached."""
        for priority in exceeded:
            self._samples_above[priority] += samples

    def on_jaw_closure(self, jaw_closure_tick: int, contact_tick: int) -> None:
        """Restore the state before the jaws closed at `jaw_closure_tick`, and stop learning."""
        self.learning_ended = True
        if not self._checkpoints:
            if contact_tick >= 0:  # contact and closure were detected together
                self.contact_tick = contact_tick
                self._set_jaws_empty(jaw_closure_tick)
            return
        self._learned_past_jaw_closure = self._checkpoints[0].tick > max(
            jaw_closure_tick, self.contact_tick + MIN_CHECKPOINT_SAMPLES
        )
        last = ([kept for kept in self._checkpoints if kept.tick <= jaw_closure_tick] or self._checkpoints[:1])[-1]
        self._bank.state = last.bank
        if self.learned_grasp is None:
            self.decision, self.probabilities = last.decision, last.probabilities
        self._errors.truncate(last.error_count)
        self._checkpoints.clear()
        if last.displacement_m < EMPTY_JAWS_TRAVEL_M:
            self._set_jaws_empty(jaw_closure_tick)

    def _set_jaws_empty(self, jaw_closure_tick: int) -> None:
        self._jaws_empty = True
        self._set_unknown()
        self.decision.label, self.decision.decided_tick = UNKNOWN, jaw_closure_tick

    def _set_unknown(self) -> None:
        self.probabilities = np.zeros_like(self.probabilities)
        self.probabilities[-1] = 1.0

    def find_invalid_reason(self) -> str | None:
        """Return the reason why this grasp is invalid; None if it is valid."""
        if self.flags & ENCODER_SLIPS:
            return "encoder slips or walks"
        if self.flags & SATURATED:
            return "the strain gage is saturated"
        if self._learned_past_jaw_closure and self.learned_grasp is None:
            return "the jaws were shut before it could be told"
        if self._in_contact_before:
            return "tissue was still held from before the grasp"
        if self.contact_tick < 0:
            return "no contact with tissue was found"
        # a loading curve is measured at the handle and does not need the kinematics of the jaws
        missing = self.lost_samples + (self.invalid_samples if self.learned_grasp is None else 0)
        if missing > MAX_MISSING_SAMPLES:
            return f"{missing} samples are missing"
        return None

    @property
    def label(self) -> str:
        """The decision's label; `no_answer` with a sensor fault, `undecided` if it is a tissue of an invalid grasp."""
        if self.flags & (ENCODER_SLIPS | SATURATED):
            return NO_ANSWER
        believed = self.decision.label == UNKNOWN or self.find_invalid_reason() is None
        return self.decision.label if believed else UNDECIDED

    @property
    def thickness_m(self) -> float | None:
        """Thickness of the tissue, m: the gap between the jaws at contact; None if not known or not reliable."""
        unbelieved = self._in_contact_before or self.flags & ENCODER_SLIPS
        return None if unbelieved else self._gap_m

    def measure_likelihood(self) -> GraspLikelihood | LearnedGrasp | None:
        """Return the grasp's evidence for its spot; None from a grasp that is no evidence."""
        if self.find_invalid_reason() is not None or self._jaws_empty:
            return None
        return self.learned_grasp or self._evidence.measure_likelihood(self._thickness_log_likelihood)

    def probabilities_by_name(self) -> dict[str, float]:
        return dict(zip((*self.names, UNKNOWN), map(float, self.probabilities), strict=True))

    def nis_by_name(self) -> dict[str, float | None]:
        return dict(zip(self.names, map(finite_or_none, self.recent_nis), strict=True))

    def time_to_decision_s(self) -> float | None:
        if self.label in NOT_NAMED:
            return None
        since = self.contact_tick if self.contact_tick >= 0 else self.start_tick
        return max(self.decision.decided_tick - since, 0) / self._rate_hz

    def compute_criteria(self) -> tuple[dict[str, float | None], dict[str, float | None]]:
        """Return the paper's convergence time (s after contact) and mean force error (N) of each filter."""
        convergence = self._errors.convergence_samples() / self._rate_hz
        error = self._errors.mean_error_n()
        return (
            dict(zip(self.names, map(finite_or_none, convergence), strict=True)),
            dict(zip(self.names, map(finite_or_none, error), strict=True)),
        )

    def finish(self, end_tick: int) -> GraspRecord:
        """Return the record of the grasp, which ended at `end_tick`."""
        convergence, error = self.compute_criteria()
        rate_hz = self._rate_hz
        label, probabilities = self.label, self.probabilities_by_name()
        parameters, log_sd = [np.nan] * 3, {}
        best = self._bank.find_likeliest_filter() if self.contact_tick >= 0 else -1
        if best >= 0:
            parameters = np.exp(self._bank.state.mean[best, PARAMETERS])
            deviations = np.sqrt(self._bank.state.cov[best].diagonal()[PARAMETERS])
            log_sd = {name: float(sd) for name, sd in zip(PARAMETER_NAMES, deviations, strict=True) if np.isfinite(sd)}
        why_invalid = self.find_invalid_reason()
        return GraspRecord(
            index=self.index,
            start_s=self.start_tick / rate_hz,
            contact_s=self.contact_tick / rate_hz if self.contact_tick >= 0 else None,
            end_s=end_tick / rate_hz,
            label=label,
            probability=probabilities.get(label),
            probabilities=probabilities,
            time_to_decision_s=self.time_to_decision_s(),
            alpha_n=finite_or_none(parameters[0]),
            beta_per_m=finite_or_none(parameters[1]),
            damping_kg_per_s=finite_or_none(parameters[2]),
            peak_force_n=finite_or_none(self.peak_force_n),
            peak_displacement_m=finite_or_none(self.peak_displacement_m),
            convergence_s=convergence,
            force_error_n=error,
            valid=why_invalid is None,
            why_invalid=why_invalid,
            held_back=bool(self.flags & LIMITED),
            peak_share_of_limit=finite_or_none(self.peak_share_of_limit),
            dose_n_s=self.dose_n_s if self.has_dose else None,
            log_sd=log_sd,
            nis=self.nis_by_name(),
            time_above_s={priority.value: count / rate_hz for priority, count in self._samples_above.items()},
        )
