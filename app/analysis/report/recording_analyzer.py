"""The class RecordingAnalyzer: collects a recording's signals, estimates, grasps, alarms and origin for a report."""

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.recordings.conditioned_blocks import read_conditioned_blocks
from acquisition.recordings.file_names import to_printable
from acquisition.recordings.recording import RecordingSource
from acquisition.sample_block import SampleBlock
from config.schema import UNKNOWN_CONDITIONS, Settings, SourceConditions, TissueLibrary, Tool
from estimator.estimate_block import EstimateBlock, GraspRecord, LabelWithdrawal, SpotVerdict, finite_or_none
from estimator.force_alarms import ForceAlarm
from estimator.online_estimator import TissueEstimator

Progress = Callable[[float], None]  # share done

# Only what a report draws, in single precision: an hour at 1 kHz then takes a third of a gigabyte.
SIGNALS = (
    "jaw_force_n",
    "jaw_force_filtered_n",
    "jaw_displacement_m",
    "jaw_displacement_filtered_m",
    "tissue_displacement_m",
    "motor_command_v",
    "limit_n",
)
ESTIMATES = (
    "probability",
    "probability_unknown",
    "threshold_n",
    "force_n",
    "alpha_n",
    "beta_per_m",
    "damping_kg_per_s",
)


def make_trace_dtype(tissues: int) -> np.dtype:
    """Return the dtype of one sample with its estimates; names and units as in `SAMPLE_DTYPE` and `estimate_dtype`."""
    single = {"probability_unknown", "threshold_n"}
    signals = [(name, "f4") for name in SIGNALS]
    estimates = [(name, "f4") if name in single else (name, "f4", (tissues,)) for name in ESTIMATES]
    return np.dtype([("tick", "i8"), *signals, *estimates])


@dataclass(frozen=True, slots=True)
class AnalyzedRecording:
    """One recording's results for a report. `traces`: (n,) of `make_trace_dtype`, ticks rising, gaps left out."""

    title: str
    tool: Tool
    library: TissueLibrary
    settings: Settings
    traces: np.ndarray
    grasps: tuple[GraspRecord, ...] = ()
    alarms: tuple[ForceAlarm, ...] = ()
    withdrawals: tuple[LabelWithdrawal, ...] = ()
    thickness_m: dict[int, float] = field(default_factory=dict)  # measured at contact, by grasp
    jaw_closure_tick: dict[int, int] = field(default_factory=dict)  # at which the jaws shut, by grasp
    lost_samples: int = 0
    tissue: str | None = None  # held, if the recording states it
    facts: dict[str, Any] = field(default_factory=dict)
    spots: tuple[SpotVerdict, ...] = ()

    @property
    def rate_hz(self) -> float:
        return self.tool.board.sample_rate_hz

    @property
    def duration_s(self) -> float:
        return (len(self.traces) + self.lost_samples) / self.rate_hz

    def grasp_traces(self, grasp: GraspRecord) -> np.ndarray:
        """Return the traces of one grasp, as a view."""
        first, last = (round(at_s * self.rate_hz) for at_s in (grasp.start_s, grasp.end_s))
        begin, end = np.searchsorted(self.traces["tick"], [first, last])
        return self.traces[begin:end]

    def traces_before_jaw_closure(self, grasp: GraspRecord) -> np.ndarray:
        """Return the traces of one grasp until its jaws shut; later forces are of steel on steel, not of tissue."""
        rows, shut_tick = self.grasp_traces(grasp), self.jaw_closure_tick.get(grasp.index)
        return rows if shut_tick is None else rows[: np.searchsorted(rows["tick"], shut_tick)]

    def grasp_alarms(self, grasp: GraspRecord) -> list[ForceAlarm]:
        """Return a grasp's warnings: for each rise of the force the one that came nearest to its threshold."""
        rises: list[ForceAlarm] = []
        rising = False
        for alarm in self.alarms:
            if alarm.priority is None:
                rising = False
            elif not grasp.start_s <= alarm.tick / self.rate_hz <= grasp.end_s:
                continue
            elif rising:
                rises[-1] = max(rises[-1], alarm, key=lambda each: each.force_n / each.threshold_n)
            else:
                rises.append(alarm)
                rising = True
        return rises

    def force_errors_n(self, grasp: GraspRecord) -> dict[str, tuple[float, float] | None]:
        """Return each filter's lowest and highest force error within a grasp (estimated less measured), N."""
        rows = self.traces_before_jaw_closure(grasp)
        errors = rows["force_n"] - rows["jaw_force_n"][:, None]
        return {name: _finite_range(errors[:, k]) for k, name in enumerate(self.library.tissues)}


def _finite_range(errors_n: np.ndarray) -> tuple[float, float] | None:
    sound = errors_n[np.isfinite(errors_n)]
    return (float(sound.min()), float(sound.max())) if len(sound) else None


def open_recorded_run(path: Path, tool: Tool) -> RecordingSource:
    """Open a recording unthrottled, skipping samples before the run; `tool` is that of another program's log.

    Raises:
        RecordingError: the file cannot be read; the text names file and line.
    """
    recording = RecordingSource(path, tool)
    recording.skip_to_run()
    return recording


def analyze_recording(
    recording: RecordingSource, title: str, library: TissueLibrary, settings: Settings, progress: Progress
) -> AnalyzedRecording:
    """Process a recording by conditioning, estimation and identification; return the results."""
    tool = recording.tool
    translator = RecordingAnalyzer(title, tool, library, settings, recording.sample_count, recording.conditions)
    for block in read_conditioned_blocks(recording, tool, settings.conditioning, progress):
        translator.process(block)
    about = recording.mcap_file.metadata if recording.mcap_file else {}
    facts = _collect_facts(recording.path, about)
    if recording.remarks:
        facts["converted"] = "; ".join(recording.remarks)
    return translator.finish(tissue=about.get("tissue") or None, facts=facts)


def _collect_facts(path: Path, about: dict[str, str]) -> dict[str, Any]:
    """`about`: the metadata of a recorded run."""
    found = path.stat()
    changed = datetime.fromtimestamp(found.st_mtime, UTC).isoformat(sep=" ", timespec="seconds")
    facts = {"file": to_printable(path.name), "size": f"{found.st_size / 1e6:.2f} MB", "last changed": changed}
    words = {
        "run_id": "run",
        "protocol": "protocol",
        "by": "started by",
        "imported_from": "imported from",
        "imported_begun": "recorded",
        "imported_remarks": "converted",
    }
    return facts | {word: about[name] for name, word in words.items() if about.get(name)}


class RecordingAnalyzer:
    """Estimates a recording's blocks in their order and collects the results."""

    def __init__(
        self,
        title: str,
        tool: Tool,
        library: TissueLibrary,
        settings: Settings,
        max_samples: int,
        conditions: SourceConditions = UNKNOWN_CONDITIONS,
    ) -> None:
        self._title, self._tool, self._library, self._settings = title, tool, library, settings
        self._session = TissueEstimator(tool, library, settings, conditions)
        self._traces = np.empty(max_samples, make_trace_dtype(len(library.tissues)))
        self.rows, self._lost_samples = 0, 0
        self._grasps: list[GraspRecord] = []
        self._alarms: list[ForceAlarm] = []
        self._withdrawals: list[LabelWithdrawal] = []
        self._thickness_m: dict[int, float] = {}
        self._jaw_closure_tick: dict[int, int] = {}

    def process(self, block: SampleBlock) -> EstimateBlock:
        """Process the next block, and return its estimates."""
        estimate = self._session.process(block)
        rows = self._traces[self.rows : self.rows + len(block.samples)]
        rows["tick"] = block.samples["tick"]
        for name in SIGNALS:
            rows[name] = block.samples[name]
        for name in ESTIMATES:
            rows[name] = estimate.estimates[name]
        self.rows += len(rows)
        self._lost_samples += block.lost_samples
        self._grasps += estimate.ended
        self._alarms += estimate.alarms
        self._withdrawals += estimate.withdrawn
        found = estimate.identification
        if found.in_grasp and found.thickness_m is not None and (thickness_m := finite_or_none(found.thickness_m)):
            self._thickness_m[found.grasp] = thickness_m
        shut = block.samples[block.samples["wall_tick"] >= 0]
        self._jaw_closure_tick |= dict(zip(shut["grasp"].tolist(), shut["wall_tick"].tolist(), strict=True))
        return estimate

    def finish(self, *, tissue: str | None = None, facts: dict[str, Any] | None = None) -> AnalyzedRecording:
        """Return the results so far, including a grasp that the end of the recording cuts short."""
        if last := self._session.finish():
            self._grasps.append(last)
        return AnalyzedRecording(
            self._title,
            self._tool,
            self._library,
            self._settings,
            self._traces[: self.rows],
            tuple(self._grasps),
            tuple(self._alarms),
            tuple(self._withdrawals),
            self._thickness_m,
            self._jaw_closure_tick,
            self._lost_samples,
            tissue,
            facts or {},
            spots=self._session.spots,
        )
