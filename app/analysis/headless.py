"""Functions behind `graspwatch run` and `graspwatch replay`: acquisition and estimation in one process, no service."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.acquisition_loop import AcquisitionController, describe_release
from acquisition.notices import RunEnded, RunOutcome
from acquisition.recordings.conditioned_blocks import read_conditioned_blocks
from acquisition.recordings.file_names import REFERENCE_ID_PREFIX
from acquisition.recordings.recording import RecordingSource
from acquisition.safety.force_limiter import ForceLimiter
from acquisition.safety_state_machine import Safety
from acquisition.tool_factory import open_tool
from app.messages.runs import RunState
from app.recordings.answer_advice import explain_missing_answers, explain_missing_reference
from app.recordings.estimate_comparison import EstimateComparator, EstimateComparison
from app.recordings.headless_recorder import HeadlessRecorder, create_run
from app.recordings.mcap_writer import RecordingContext
from config.schema import GraspProtocol, ReferenceGrasp, Settings, SourceConditions, TissueLibrary, Tool
from estimator.estimate_block import GraspRecord, SpotVerdict
from estimator.learning.reference_measurement import measure_reference
from estimator.online_estimator import TissueEstimator
from estimator.worker import to_threshold_update

Progress = Callable[[float], None]


@dataclass(slots=True)
class RunSummary:
    """The result of a run or replay, which `--json` prints. SI units; None where there is no value."""

    source: str
    library: str
    rate_hz: float
    samples: int = 0
    lost_samples: int = 0
    grasps: list[GraspRecord] = field(default_factory=list)
    spots: tuple[SpotVerdict, ...] = ()
    releases: list[str] = field(default_factory=list)  # a message for each grasp that the limiter released
    force_scale: str = ""  # the tool's force scale in words
    failure: str | None = None  # why a run ended before its protocol did
    reference: ReferenceGrasp | None = None  # that the run was, with empty jaws
    comparison: EstimateComparison | None = None  # of a replay's estimates with the recorded ones
    advice: str | None = None  # of a replay without any answer: why, and what to do

    def document(self) -> dict[str, Any]:
        document = {
            "source": self.source,
            "samples": self.samples,
            "lost_samples": self.lost_samples,
            "duration_s": (self.samples + self.lost_samples) / self.rate_hz,
            "library": self.library,
            "force_scale": self.force_scale,
            "grasps": [grasp.model_dump() for grasp in self.grasps],
            "spots": [spot.model_dump() for spot in self.spots],
        }
        if self.releases:
            document["let_go"] = self.releases
        if self.reference:
            document["reference"] = self.reference.model_dump(mode="json")
        if self.advice:
            document["advice"] = self.advice
        if self.comparison:
            document["recorded"] = self.comparison.document()
        return document


def run_protocol(
    tool: Tool,
    library: TissueLibrary,
    settings: Settings,
    protocol: GraspProtocol,
    tissue: str | None,
    *,
    cycles: int,
    seed: int,
    real_time: bool,
    recording_path: Path | None,
    progress: Progress,
) -> RunSummary:
    """Play a protocol on the simulated grasper; return what was identified. `progress` receives the seconds played.

    Without a tissue the jaws are empty: the run is a reference grasp.

    Raises:
        RefusedError: the protocol exceeds the tool's limits.
        ToolError: the board failed.
        RecordingError: the file exists, or cannot be written.
        CalibrationError: the grasps are no reference grasp.
    """
    report = RunSummary(
        f"{tool.name}:{tissue or 'empty'}", library.name, tool.board.sample_rate_hz, force_scale=tool.scale_text
    )
    began_at = datetime.now(UTC)
    session = TissueEstimator(tool, library, settings, SourceConditions(began_at))
    source, grasper = open_tool(tool, library, tissue or next(iter(library.tissues)), seed, virtual=not real_time)
    run_id = recording_path.stem if recording_path else "run"
    if tissue is None:
        run_id = REFERENCE_ID_PREFIX + run_id
        assert grasper, "runs without a service are on the simulated grasper"
        grasper.gauge_m = 0.0
    reference_samples: list[np.ndarray] = []
    context = RecordingContext(tool, library, settings)
    recorded = (
        HeadlessRecorder(recording_path, context, create_run(run_id, protocol.name, cycles, tissue), protocol)
        if recording_path
        else None
    )
    with source, recorded or contextlib.nullcontext() as file:
        limiter = ForceLimiter(tool, library, settings.limiter)
        acquisition = AcquisitionController(source, tool, settings.conditioning, limiter, Safety.ARMED)
        acquisition.start(run_id, protocol, cycles)
        ended: list[RunEnded] = []
        while not ended:
            block = acquisition.process_block()
            assert block is not None, "a tool's samples have no end"
            report.samples += len(block.samples)
            report.lost_samples += block.lost_samples
            if tissue is None:
                reference_samples.append(block.samples)
            estimate = session.process(block)
            if file:
                file.append(block, estimate)
            report.grasps += estimate.ended
            limit = to_threshold_update(estimate.identification)
            acquisition.set_threshold(limit.threshold_n, limit.tick)
            for why in acquisition.pop_release_reasons():
                report.releases.append(describe_release(why))
                if file:
                    file.add_release_alarm(report.releases[-1])
            ended = acquisition.pop_ended_runs()
            progress(report.samples / tool.board.sample_rate_hz)
        last = session.finish()
        if file:
            file.add_interrupted_grasp(last, session.spots)
            file.end_run(RunState(ended[0].end), ended[0].why)
    if last:
        report.grasps.append(last)
    report.spots = session.spots
    if ended[0].end is RunOutcome.FAILED:
        report.failure = f"The run was ended early with the motor at zero: {ended[0].why}."
    elif tissue is None:
        report.reference = measure_reference(np.concatenate(reference_samples), tool, began_at, None)
    return report


def replay_recording(
    recording: RecordingSource,
    recording_context: RecordingContext,
    progress: Progress,
    reference: ReferenceGrasp | None = None,
) -> RunSummary:
    """Process a recording anew by calibration, conditioning, estimation and identification; return the result.

    `reference`: the day's reference grasp, instead of the recording's own. Of an MCAP file, samples before the run are
    skipped, and the estimates are compared with the recorded ones.

    Raises:
        RecordingError: the file is damaged; the text names the place.
    """
    tool, library, settings = recording_context.tool, recording_context.library, recording_context.settings
    report = RunSummary(str(recording.path), library.name, tool.board.sample_rate_hz, force_scale=tool.scale_text)
    conditions = recording.conditions
    if reference:
        conditions = SourceConditions(conditions.recorded_at, reference)
    session = TissueEstimator(tool, library, settings, conditions)
    comparing = (
        EstimateComparator(recording.mcap_file, recording_context, recording.first_tick)
        if recording.mcap_file
        else None
    )
    recording.skip_to_run()
    for block in read_conditioned_blocks(recording, tool, settings.conditioning, progress):
        report.samples += len(block.samples)
        report.lost_samples += block.lost_samples
        estimate = session.process(block)
        report.grasps += estimate.ended
        if comparing:
            comparing.compare(estimate.estimates)
    if last := session.finish():
        report.grasps.append(last)
    report.spots = session.spots
    report.comparison = comparing.result if comparing else None
    if recording.is_reference_grasp:
        report.advice = "This is a reference grasp on empty jaws: there is nothing to name. Use it with --reference."
        return report
    advice = explain_missing_answers(tool, library, report.grasps), explain_missing_reference(tool, library, conditions)
    report.advice = " ".join(filter(None, advice)) or None
    return report
