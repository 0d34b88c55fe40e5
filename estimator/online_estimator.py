"""The class TissueEstimator, which turns the sample blocks of a source into estimate blocks, from first to last."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from acquisition.recordings.file_names import is_reference_run
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock, SampleFlag
from acquisition.signals.grasp_tracker import BACKDATING_SAMPLES, COMMAND_CONFIRM_SAMPLES
from config.schema import UNKNOWN_CONDITIONS, Settings, SourceConditions, TissueLibrary, Tool
from estimator.constants import MIN_REST_SAMPLES, REST_SAMPLES, REST_SETTLING_SAMPLES, REST_VARIANCE_RANGE
from estimator.decision import NOT_NAMED, UNDECIDED, UNKNOWN
from estimator.estimate_block import (
    EstimateBlock,
    GraspRecord,
    IdentificationResult,
    LabelWithdrawal,
    SpotVerdict,
    blank_estimates,
    estimate_dtype,
    finite_or_none,
)
from estimator.evidence import BankEvidence
from estimator.filter_bank import FilterBank
from estimator.force_alarms import ForceAlarm, ForceAlarmMonitor
from estimator.forecast import ForceForecast
from estimator.grasp_estimation import GraspEstimator
from estimator.loading.learned_evidence import LearnedEvidence, LearnedGrasp
from estimator.spots import SpotTracker

IN_GRASP, CONTACT, CONTACT_SENSED = SampleFlag.IN_GRASP.value, SampleFlag.CONTACT.value, SampleFlag.CONTACT_SENSED.value
INVALID, ENCODER_SLIPS, LIMITED = SampleFlag.INVALID.value, SampleFlag.ENCODER_SLIPS.value, SampleFlag.LIMITED.value
NEW_SPOT = SampleFlag.NEW_SPOT.value
APPROACH_SAMPLES = 8  # samples before contact that give the speed of the closing jaws
STEP_SAMPLES = 5  # probabilities are updated at ticks that are multiples of this, and at a block's end
# Median absolute difference of two Gaussian samples, in standard deviations of one sample.
MEDIAN_DIFFERENCE_PER_SD = 0.6745 * 2**0.5
MIN_PLAUSIBLE_PROBABILITY = 0.05  # a tissue at least this probable keeps its threshold in force
CRITERIA_INTERVAL_STEPS = 20  # steps between two evaluations of the paper's criteria for the live view


class RestNoiseEstimator:
    """Estimator of the strain gage's noise at rest before a grasp.

    The noise may differ from the tool file's value, because the gage ages and its cable moves.
    """

    def __init__(self, tool: Tool) -> None:
        self._tool_file_variance_v2 = tool.noise.strain_var_v2
        self._differences_v: deque[float] = deque(maxlen=REST_SAMPLES)
        self._last_v: float | None = None
        self._rest_samples = REST_SETTLING_SAMPLES  # a source does not begin after a grasp: no settling needed

    def update(self, strain_v: list[float], *, at_rest: bool) -> None:
        """Process the samples of a step; `at_rest` is False if the step's last sample is in a grasp."""
        if not at_rest:
            self._rest_samples, self._last_v = 0, None
            return
        for value in strain_v:
            if not math.isfinite(value):
                self._last_v = None
                continue
            if self._rest_samples >= REST_SETTLING_SAMPLES and self._last_v is not None:
                self._differences_v.append(abs(value - self._last_v))
            self._rest_samples += 1
            self._last_v = value

    def variance_v2(self) -> float:
        """Return the variance of one sample, V².

        It comes from the median step between samples, which is robust against drift and spikes. With fewer than
        `MIN_REST_SAMPLES` it is the tool file's variance.
        """
        if len(self._differences_v) < MIN_REST_SAMPLES:
            return self._tool_file_variance_v2
        sd_v = float(np.median(self._differences_v)) / MEDIAN_DIFFERENCE_PER_SD
        low, high = REST_VARIANCE_RANGE
        return min(max(sd_v**2, low * self._tool_file_variance_v2), high * self._tool_file_variance_v2)


class _Step(NamedTuple):
    """What the estimator needs of one step: fields of its last sample, and figures over all its samples.

    Reading them for a whole block at a time takes a tenth of the time.
    """

    tick: int
    last_flags: int
    grasp: int
    grasp_start_tick: int
    contact_tick: int
    jaw_closure_tick: int
    flags: int
    """Of all samples."""
    mean_force_n: float
    """Of the force without the filter."""
    peak_force_n: float
    peak_share_of_limit: float
    peak_displacement_m: float


def _summarize_steps(samples: np.ndarray, ends: list[int]) -> list[_Step]:
    """Summarize the steps of a block, which end before the rows `ends`; missing values do not count as peaks."""
    starts, last = [0, *ends[:-1]], samples[np.array(ends) - 1]
    fields = ("tick", "flags", "grasp", "grasp_start_tick", "contact_tick", "wall_tick")
    raw_n, force_n = samples["jaw_force_n"], samples["jaw_force_filtered_n"]
    peaks = (force_n, force_n / samples["limit_n"], samples["tissue_displacement_m"])
    columns = [
        *(last[name].tolist() for name in fields),
        np.bitwise_or.reduceat(samples["flags"], starts).tolist(),
        [float(np.add.reduce(raw_n[begin:end])) / (end - begin) for begin, end in zip(starts, ends, strict=True)],
        *(np.fmax.reduceat(each, starts).tolist() for each in peaks),
    ]
    return [_Step(*values) for values in zip(*columns, strict=True)]


def _higher(peak: float, value: float) -> float:
    """Return the higher of two values, of which either may be missing (NaN)."""
    return value if value > peak or math.isnan(peak) else peak


class TissueEstimator:
    """Estimator of all grasps of a source. Call `process` with each block in order, and `finish` after the last one."""

    def __init__(
        self, tool: Tool, library: TissueLibrary, settings: Settings, conditions: SourceConditions = UNKNOWN_CONDITIONS
    ) -> None:
        """Create the filters and the evidence for a tool and a library.

        `conditions`: those of the source; by default nothing is known of its day.

        Raises:
            ConfigurationError: the library was learned with a tool of another calibration.
        """
        self._tool = tool
        self._rate_hz = tool.board.sample_rate_hz
        self._thresholds_n = library.convert_thresholds_to_displayed_n(tool)
        self._lowest_threshold_n = min(self._thresholds_n.values())
        self._settings = settings.identification
        self._opening_m = tool.opening_m
        self.bank = FilterBank.from_tool(tool, library)
        self.evidence = BankEvidence(self.bank, library, self._settings)
        library.check_tool(tool)
        self._learned_evidence = LearnedEvidence(library, tool, self._settings, conditions) if library.learned else None
        self._names = (*library.tissues, UNKNOWN)
        self._alarm_monitor = ForceAlarmMonitor(settings.warnings)
        self._dtype = estimate_dtype(len(library.tissues))
        self._contact_detection = tool.contact
        self._run = ""
        self._reset()

    def _reset(self, first_tick: int = 0) -> None:
        """Discard all samples before `first_tick`. The force alarms keep their state, because the force continues."""
        self._recent_samples = np.zeros(0, SAMPLE_DTYPE)
        self._rest_noise = RestNoiseEstimator(self._tool)
        self._previous_closure_deg: float | None = (
            None  # jaw closure angle of the previous grasp, for learned libraries
        )
        self._strain_var_v2 = self._rest_noise.variance_v2()  # as measured before the current grasp
        self._forecast = ForceForecast(self._rate_hz)
        self._history_samples = max(2 * BACKDATING_SAMPLES, self._forecast.window_samples)
        self._grasp: GraspEstimator | None = None
        self._in_grasp = False
        self._published_label = UNDECIDED  # last published label of the current grasp
        self._criteria = self._empty_criteria()
        self._last_tick = 0
        self._spots = SpotTracker(
            self._learned_evidence or self.evidence, self._names, self._settings, self._rate_hz, first_tick
        )

    def _empty_criteria(self) -> tuple[dict[str, float | None], dict[str, float | None]]:
        nothing: dict[str, float | None] = dict.fromkeys(self._thresholds_n)
        return nothing, nothing

    def process(self, block: SampleBlock) -> EstimateBlock:
        """Return estimates, identification, finished grasps and alarms for one block."""
        ended: list[GraspRecord] = []
        if block.run and block.run != self._run:
            cut_short = self.finish()
            ended += [cut_short] if cut_short else []
            self._reset(int(block.samples["tick"][0]))
        self._run = block.run
        n, kept = len(block.samples), len(self._recent_samples)
        window = np.empty(kept + n, SAMPLE_DTYPE)
        window[:kept], window[kept:] = self._recent_samples, block.samples
        self._recent_samples = window[-self._history_samples :]
        estimates = blank_estimates(self._dtype, block.samples["tick"])
        if self._in_grasp and self._grasp:
            self._grasp.lost_samples += int(block.samples["tick"][0]) - self._last_tick - 1
        alarms: list[ForceAlarm] = []
        withdrawn: list[LabelWithdrawal] = []
        ends = [*(np.flatnonzero(np.diff(block.samples["tick"] // STEP_SAMPLES)) + 1).tolist(), n]
        begin = 0
        for end, step in zip(ends, _summarize_steps(block.samples, ends), strict=True):
            rows = estimates[begin:end]
            self._process_step(step, window[: kept + end], rows, ended, withdrawn)
            self._update_alarms(step, rows, alarms)
            begin = end
        self._last_tick = int(block.samples["tick"][-1])
        return EstimateBlock(
            block.sequence,
            block.t_mono_ns,
            block.lost_samples,
            estimates,
            self._build_identification(block.samples),
            tuple(ended),
            tuple(alarms),
            tuple(withdrawn),
        )

    def use_conditions(self, conditions: SourceConditions) -> None:
        """Compare later grasps with a learned library under other conditions."""
        if self._learned_evidence:
            self._learned_evidence.use_conditions(conditions)

    def finish(self) -> GraspRecord | None:
        """Return the record of a grasp that the source's end cut short; None if there is none."""
        if not (self._in_grasp and self._grasp):
            return None
        self._in_grasp = False
        return self._end_grasp(self._grasp, self._last_tick)

    @property
    def spots(self) -> tuple[SpotVerdict, ...]:
        """Verdicts of the spots so far, in order; the last one may be of a spot without a grasp yet."""
        return self._spots.verdicts

    def _end_grasp(self, grasp: GraspEstimator, end_tick: int) -> GraspRecord:
        self._spots.append(grasp, end_tick)
        return grasp.finish(end_tick)

    def _process_step(
        self,
        step: _Step,
        window: np.ndarray,
        rows: np.ndarray,
        ended: list[GraspRecord],
        withdrawn: list[LabelWithdrawal],
    ) -> None:
        """Begin, follow or end a grasp with the last samples of `window`, as many as there are `rows`."""
        in_grasp = bool(step.last_flags & IN_GRASP)
        self._rest_noise.update(window["strain_v"][-len(rows) :].tolist(), at_rest=not in_grasp)
        if self._in_grasp and self._grasp and (not in_grasp or step.grasp != self._grasp.index):
            ended.append(self._end_grasp(self._grasp, step.tick - COMMAND_CONFIRM_SAMPLES + 1))
            self._in_grasp = False
            self._criteria = (ended[-1].convergence_s, ended[-1].force_error_n)
        if step.flags & NEW_SPOT:
            self._spots.request(step.tick, in_grasp=in_grasp)
        if in_grasp and not self._in_grasp and not is_reference_run(self._run):
            self._in_grasp = True
            self._spots.on_grasp_start(step.grasp_start_tick)
            self._criteria = self._empty_criteria()
            self._published_label = UNDECIDED
            self._strain_var_v2 = self._rest_noise.variance_v2()
            self._grasp = GraspEstimator(
                step.grasp,
                step.grasp_start_tick,
                self.bank,
                self.evidence,
                self._settings,
                self._rate_hz,
                in_contact_before=self._is_touch_sensed(window, step.grasp_start_tick),
                learned_grasp=self._start_learned_grasp(window[: -len(rows)], step.grasp_start_tick),
            )
        if self._in_grasp and self._grasp:
            self._update_grasp(self._grasp, step, window, rows)
            self._note_withdrawal(self._grasp, step.tick, withdrawn)

    def _start_learned_grasp(self, before: np.ndarray, start_tick: int) -> LearnedGrasp | None:
        """Return the loading-curve estimator of a learned library; None without one.

        It receives the samples `before` this step that belong to the grasp already.
        """
        if self._learned_evidence is None:
            return None
        if self._grasp and self._grasp.learned_grasp:  # the previous grasp
            shut_deg = self._grasp.learned_grasp.loading_curve.jaw_closure_deg
            if shut_deg is not None or self._grasp.flags & ENCODER_SLIPS:
                self._previous_closure_deg = None if self._grasp.flags & ENCODER_SLIPS else shut_deg
        learned = self._learned_evidence.start_grasp(self._previous_closure_deg, first=self._spots.is_new)
        learned.loading_curve.append(before[np.searchsorted(before["tick"], start_tick) :])
        return learned

    def _note_withdrawal(self, grasp: GraspEstimator, tick: int, withdrawn: list[LabelWithdrawal]) -> None:
        """Append a withdrawal if the grasp no longer has the label that was published last."""
        told, self._published_label = self._published_label, grasp.label
        if told not in (*NOT_NAMED, grasp.label):
            left = grasp.probabilities_by_name()[told]
            withdrawn.append(LabelWithdrawal(tick, grasp.index, told, left, grasp.find_invalid_reason()))

    def _is_touch_sensed(self, window: np.ndarray, tick: int) -> bool:
        """Return whether a trusted touch sensor detected contact at that tick."""
        if not self._contact_detection.touch_trusted:
            return False
        at = window[min(int(np.searchsorted(window["tick"], tick)), len(window) - 1)]
        return max(float(at["touch_1_v"]), float(at["touch_2_v"])) > self._contact_detection.touch_threshold_v

    def _update_grasp(self, grasp: GraspEstimator, step: _Step, window: np.ndarray, rows: np.ndarray) -> None:
        samples = window[-len(rows) :]
        grasp.flags |= step.flags
        grasp.peak_force_n = _higher(grasp.peak_force_n, step.peak_force_n)
        grasp.peak_share_of_limit = _higher(grasp.peak_share_of_limit, step.peak_share_of_limit)
        grasp.peak_displacement_m = _higher(grasp.peak_displacement_m, step.peak_displacement_m)
        if step.contact_tick >= 0:
            is_first = not grasp.has_dose  # contact was detected late
            grasp.add_dose(window[np.searchsorted(window["tick"], step.contact_tick) :] if is_first else samples)
        if step.jaw_closure_tick >= 0 and not grasp.learning_ended:
            grasp.on_jaw_closure(step.jaw_closure_tick, step.contact_tick)
        grasp.learning_ended |= bool(grasp.flags & ENCODER_SLIPS)
        if step.contact_tick >= 0 and not grasp.learning_ended:
            self._update_filters(grasp, window, rows)
        elif grasp.learning_ended and grasp.learned_grasp is None:
            grasp.decision.update(grasp.probabilities, step.tick)  # a decision may still become due
        grasp.update_loading_curve(samples)
        rows["probability"] = grasp.probabilities[:-1]
        rows["probability_unknown"] = grasp.probabilities[-1]

    def _update_filters(self, grasp: GraspEstimator, window: np.ndarray, rows: np.ndarray) -> None:
        """Pass the samples in contact to the filters, including those from before contact was detected."""
        samples = window[-len(rows) :]
        if grasp.contact_tick < 0:
            since = int(np.searchsorted(window["tick"], window[-1]["contact_tick"]))
            before_m = window["jaw_displacement_m"][max(since - APPROACH_SAMPLES, 0) : since]
            sensed = bool(window[-1]["flags"] & CONTACT_SENSED)  # a back-dated first sample lacks the flag
            sound = np.flatnonzero((window["flags"][since:] & INVALID) == 0)
            if not len(sound):
                return  # no valid sample in contact yet
            first = since + int(sound[0])
            grasp.on_contact(window[first], before_m, self._opening_m, self._strain_var_v2, contact_sensed=sensed)
            samples = window[first + 1 :]
            rows = blank_estimates(self._dtype, samples["tick"])  # discarded: earlier rows are published already
        sound = (samples["flags"] & INVALID) == 0
        if not sound.all():
            grasp.invalid_samples += int(np.count_nonzero(~sound))
            samples, rows = samples[sound], rows[sound]
        if len(samples):
            grasp.process(samples, rows)

    def _update_alarms(self, step: _Step, rows: np.ndarray, alarms: list[ForceAlarm]) -> None:
        threshold_n, tissue = self._find_active_threshold(self._grasp.label if self._grasp else UNDECIDED)
        rows["threshold_n"] = threshold_n
        force_n = step.mean_force_n
        if math.isfinite(force_n):
            if self._in_grasp and self._grasp:
                exceeded = self._alarm_monitor.find_exceeded(force_n, threshold_n)
                self._grasp.add_time_above(exceeded, len(rows))
            alarm = self._alarm_monitor.update(step.tick, force_n, threshold_n, tissue)
            if alarm:
                alarms.append(alarm)

    def _find_active_threshold(self, label: str) -> tuple[float, str | None]:
        """Return the threshold in force, N, and its tissue.

        While no tissue is named it is the library's lowest threshold, with None as tissue. Otherwise it is the lowest
        of the named tissue and all tissues that are still plausible.
        """
        if not (self._in_grasp and self._grasp and label in self._thresholds_n):
            return self._lowest_threshold_n, None
        likely = zip(self._thresholds_n, self._grasp.probabilities[:-1], strict=True)
        plausible = [name for name, probability in likely if name == label or probability >= MIN_PLAUSIBLE_PROBABILITY]
        tissue = min(plausible, key=self._thresholds_n.__getitem__)
        return self._thresholds_n[tissue], tissue

    def _build_identification(self, samples: np.ndarray) -> IdentificationResult:
        grasp, last = self._grasp, samples[-1]
        step = int(last["tick"]) // STEP_SAMPLES
        held_steps = (int(last["tick"]) - grasp.start_tick) // STEP_SAMPLES if grasp else 0
        # The criteria read the whole grasp, so they are computed less often as it gets longer.
        every = max(CRITERIA_INTERVAL_STEPS, held_steps // CRITERIA_INTERVAL_STEPS)
        if grasp and self._in_grasp and not grasp.learning_ended and step % every == 0:
            self._criteria = grasp.compute_criteria()
        probabilities = grasp.probabilities_by_name() if grasp else {}
        label = grasp.label if grasp else UNDECIDED
        threshold_n, tissue = self._find_active_threshold(label)
        return IdentificationResult(
            tick=int(last["tick"]),
            grasp=grasp.index if grasp else 0,
            in_grasp=self._in_grasp,
            in_contact=bool(last["flags"] & CONTACT),
            label=label,
            probability=probabilities.get(label),
            probabilities=probabilities,
            time_to_decision_s=grasp.time_to_decision_s() if grasp else None,
            force_n=finite_or_none(float(last["jaw_force_filtered_n"])),
            peak_force_n=finite_or_none(grasp.peak_force_n) if grasp else None,
            threshold_n=threshold_n,
            threshold_tissue=tissue,
            limit_n=finite_or_none(float(last["limit_n"])),
            holding_back=bool(last["flags"] & LIMITED),
            time_to_limit_s=self._forecast_time_to_limit_s(float(last["limit_n"])),
            thickness_m=grasp.thickness_m if grasp else None,
            convergence_s=self._criteria[0],
            force_error_n=self._criteria[1],
            spots=self._spots.verdicts,
            nis=grasp.nis_by_name() if grasp else {},
            dose_n_s=grasp.dose_n_s if grasp else None,
            spot_dose_n_s=self._spots.dose_n_s + (grasp.dose_n_s if grasp and self._in_grasp else 0.0),
        )

    def _forecast_time_to_limit_s(self, limit_n: float) -> float | None:
        """Return the forecast time until the force reaches the limit, s.

        None between grasps, after missing samples, and where no limit is enforced (NaN).
        """
        recent, n = self._recent_samples, self._forecast.window_samples
        if not self._in_grasp or math.isnan(limit_n):
            return None
        if len(recent) < n or recent["tick"][-1] - recent["tick"][-n] != n - 1:
            return None
        noise_sd_n = abs(float(recent["newton_per_volt"][-1])) * math.sqrt(self._strain_var_v2)
        return self._forecast.forecast_time_to_limit_s(recent["jaw_force_n"][-n:], limit_n, noise_sd_n)
