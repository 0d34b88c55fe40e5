"""From sample blocks to estimate blocks: follows a source from its first sample to its last."""

import numpy as np

from acquisition.blocks import SAMPLE, Flag, SampleBlock
from acquisition.contact import BACKDATE_SAMPLES, COMMAND_SAMPLES
from config.schema import Settings, TissueLibrary, Tool
from estimator.alarms import ForceAlarm, ForceWarnings
from estimator.bank import Bank
from estimator.blocks import EstimateBlock, GraspRecord, Identification, blank_estimates, estimate_dtype, finite
from estimator.decision import UNDECIDED
from estimator.evidence import Evidence
from estimator.grasp import GraspEstimation

IN_GRASP, CONTACT, INVALID, ENCODER_SLIPS = (
    Flag.IN_GRASP.value, Flag.CONTACT.value, Flag.INVALID.value, Flag.ENCODER_SLIPS.value,
)  # fmt: skip
STEP_SAMPLES = 5  # probabilities are renewed at ticks that are multiples of this, however samples are cut into blocks
PLAUSIBLE = 0.05  # a tissue at least this probable keeps its threshold in force
CRITERIA_EVERY = 20  # steps between two evaluations of the paper's criteria for the live view


class EstimationSession:
    """The estimator's whole state. Call `process` with each block in its order, `finish` after the last."""

    def __init__(self, tool: Tool, library: TissueLibrary, settings: Settings) -> None:
        self._rate_hz = tool.board.sample_rate_hz
        self._thresholds = {name: library.threshold_n(name) for name in library.tissues}
        self._lowest_n = library.lowest_threshold_n
        self._settings = settings.identification
        self.bank = Bank(tool, library)
        self.evidence = Evidence(self.bank, self._settings)
        self._warnings = ForceWarnings(settings.warnings)
        self._dtype = estimate_dtype(len(library.tissues))
        self._recent = np.zeros(0, SAMPLE)
        self._grasp: GraspEstimation | None = None
        self._in_grasp = False
        self._criteria = self._empty_criteria()
        self._last_tick = 0

    def _empty_criteria(self) -> tuple[dict[str, float | None], dict[str, float | None]]:
        nothing: dict[str, float | None] = dict.fromkeys(self._thresholds)
        return nothing, nothing

    def process(self, block: SampleBlock) -> EstimateBlock:
        """Estimates, identification, finished grasps and alarms for one block."""
        n, kept = len(block.samples), len(self._recent)
        window = np.empty(kept + n, SAMPLE)
        window[:kept], window[kept:] = self._recent, block.samples
        self._recent = window[-2 * BACKDATE_SAMPLES :]
        estimates = blank_estimates(self._dtype, block.samples["tick"])
        if self._in_grasp and self._grasp:
            self._grasp.lost_samples += int(block.samples["tick"][0]) - self._last_tick - 1
        ended: list[GraspRecord] = []
        alarms: list[ForceAlarm] = []
        ends = [*(np.flatnonzero(np.diff(block.samples["tick"] // STEP_SAMPLES)) + 1).tolist(), n]
        begin = 0
        for end in ends:
            rows = estimates[begin:end]
            self._step(window[: kept + end], rows, ended)
            self._warn(window[kept + begin : kept + end], rows, alarms)
            begin = end
        self._last_tick = int(block.samples["tick"][-1])
        return EstimateBlock(
            block.sequence, block.t_mono_ns, block.lost_samples, estimates,
            self._identification(block.samples), tuple(ended), tuple(alarms),
        )  # fmt: skip

    def finish(self) -> GraspRecord | None:
        """The record of a grasp that the source's end cut short."""
        if not (self._in_grasp and self._grasp):
            return None
        self._in_grasp = False
        return self._grasp.finish(self._last_tick, self._rate_hz)

    def _step(self, window: np.ndarray, rows: np.ndarray, ended: list[GraspRecord]) -> None:
        """The last few samples of `window`: begin, follow or end the grasp they belong to."""
        last = window[-1]
        in_grasp = bool(last["flags"] & IN_GRASP)
        if self._in_grasp and self._grasp and (not in_grasp or last["grasp"] != self._grasp.index):
            ended.append(self._grasp.finish(int(last["tick"]) - COMMAND_SAMPLES + 1, self._rate_hz))
            self._in_grasp = False
            self._criteria = (ended[-1].convergence_s, ended[-1].force_error_n)
        if in_grasp and not self._in_grasp:
            self._in_grasp = True
            self._criteria = self._empty_criteria()
            self._grasp = GraspEstimation(
                int(last["grasp"]),
                int(last["grasp_start_tick"]),
                self.bank,
                self.evidence,
                self._settings,
                self._rate_hz,
            )
        if self._in_grasp and self._grasp:
            self._follow(self._grasp, window, rows)

    def _follow(self, grasp: GraspEstimation, window: np.ndarray, rows: np.ndarray) -> None:
        samples, last = window[-len(rows) :], window[-1]
        grasp.flags |= int(np.bitwise_or.reduce(samples["flags"]))
        grasp.peak_n = np.fmax(grasp.peak_n, np.fmax.reduce(samples["jaw_force_filtered_n"]))
        grasp.peak_m = np.fmax(grasp.peak_m, np.fmax.reduce(samples["tissue_displacement_m"]))
        if last["wall_tick"] >= 0 and not grasp.over:
            grasp.shut(int(last["wall_tick"]))
        grasp.over |= bool(grasp.flags & ENCODER_SLIPS)
        if last["contact_tick"] >= 0 and not grasp.over:
            self._learn(grasp, window, rows)
        rows["probability"] = grasp.probabilities[:-1]
        rows["probability_unknown"] = grasp.probabilities[-1]

    def _learn(self, grasp: GraspEstimation, window: np.ndarray, rows: np.ndarray) -> None:
        """Give the samples in contact to the filters, those before contact was known included."""
        samples = window[-len(rows) :]
        if grasp.contact_tick < 0:
            since = int(np.searchsorted(window["tick"], window[-1]["contact_tick"]))
            grasp.begin(window[since], window["jaw_displacement_m"][max(since - 8, 0) : since], self._rate_hz)
            samples = window[since:]
            rows = blank_estimates(self._dtype, samples["tick"])  # what is earlier has been published
        sound = (samples["flags"] & INVALID) == 0
        if not sound.all():
            samples, rows = samples[sound], rows[sound]
        if len(samples):
            grasp.take(samples, rows)

    def _warn(self, samples: np.ndarray, rows: np.ndarray, alarms: list[ForceAlarm]) -> None:
        threshold_n, tissue = self._threshold(self._grasp.label if self._grasp else UNDECIDED)
        rows["threshold_n"] = threshold_n
        force_n = float(np.add.reduce(samples["jaw_force_n"])) / len(samples)
        if np.isfinite(force_n):
            alarm = self._warnings.update(int(samples["tick"][-1]), force_n, threshold_n, tissue)
            if alarm:
                alarms.append(alarm)

    def _threshold(self, label: str) -> tuple[float, str | None]:
        """Injury threshold in force, N, and whose it is; the lowest of the library (None) while no tissue is named.

        A named tissue's threshold counts only as far as no other tissue with a lower one is still plausible.
        """
        if not (self._in_grasp and self._grasp and label in self._thresholds):
            return self._lowest_n, None
        likely = zip(self._thresholds, self._grasp.probabilities[:-1], strict=True)
        plausible = [name for name, probability in likely if name == label or probability >= PLAUSIBLE]
        tissue = min(plausible, key=self._thresholds.__getitem__)
        return self._thresholds[tissue], tissue

    def _identification(self, samples: np.ndarray) -> Identification:
        grasp, last = self._grasp, samples[-1]
        step = int(last["tick"]) // STEP_SAMPLES
        held_steps = (int(last["tick"]) - grasp.start_tick) // STEP_SAMPLES if grasp else 0
        every = max(CRITERIA_EVERY, held_steps // CRITERIA_EVERY)  # the longer the grasp, the dearer the look back
        if grasp and self._in_grasp and not grasp.over and step % every == 0:
            self._criteria = grasp.criteria(self._rate_hz)
        probabilities = grasp.named_probabilities() if grasp else {}
        label = grasp.label if grasp else UNDECIDED
        threshold_n, tissue = self._threshold(label)
        return Identification(
            tick=int(last["tick"]),
            grasp=grasp.index if grasp else 0,
            in_grasp=self._in_grasp,
            in_contact=bool(last["flags"] & CONTACT),
            label=label,
            probability=probabilities.get(label),
            probabilities=probabilities,
            time_to_decision_s=grasp.time_to_decision_s(self._rate_hz) if grasp else None,
            force_n=finite(float(last["jaw_force_filtered_n"])),
            peak_force_n=finite(grasp.peak_n) if grasp else None,
            threshold_n=threshold_n,
            threshold_tissue=tissue,
            convergence_s=self._criteria[0],
            force_error_n=self._criteria[1],
        )
