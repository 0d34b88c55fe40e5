"""`graspwatch run` and `graspwatch replay` without a service: the same acquisition and estimation, in one process."""

import contextlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from acquisition.control import Acquisition, RunEnd, RunEnded, let_go_text
from acquisition.limiter import HoldBack
from acquisition.pipeline import Pipeline
from acquisition.recordings.playing import Recording
from acquisition.safety import Safety
from acquisition.tools import open_tool
from app.record.comparing import Comparing, Comparison
from app.record.headless_file import HeadlessFile, new_run
from app.record.run_file import Rig
from app.wire import RunState
from config.schema import Protocol, Settings, TissueLibrary, Tool
from estimator.blocks import GraspRecord
from estimator.session import EstimationSession
from estimator.worker import limit_of

Progress = Callable[[float], None]


@dataclass(slots=True)
class Report:
    """What `--json` prints. SI units; None where there is no value."""

    source: str
    library: str
    rate_hz: float
    samples: int = 0
    lost_samples: int = 0
    grasps: list[GraspRecord] = field(default_factory=list)
    let_go: list[str] = field(default_factory=list)  # what is told of each grasp that the limiter let go
    force_scale: str = ""  # by which scale forces are told, for people
    failure: str | None = None  # why a run ended before its protocol
    comparison: Comparison | None = None  # of a replay with what was recorded

    def document(self) -> dict[str, Any]:
        document = {
            "source": self.source,
            "samples": self.samples,
            "lost_samples": self.lost_samples,
            "duration_s": (self.samples + self.lost_samples) / self.rate_hz,
            "library": self.library,
            "force_scale": self.force_scale,
            "grasps": [asdict(grasp) for grasp in self.grasps],
        }
        if self.let_go:
            document["let_go"] = self.let_go
        if self.comparison:
            document["recorded"] = self.comparison.document()
        return document


def run_protocol(
    tool: Tool,
    library: TissueLibrary,
    settings: Settings,
    protocol: Protocol,
    tissue: str,
    *,
    cycles: int,
    seed: int,
    real_time: bool,
    record: Path | None,
    progress: Progress,
) -> Report:
    """Play a protocol on the simulated grasper and identify what it grasps; `record` is the file to write, if any.

    Raises:
        RefusedError: the protocol passes the tool's limits.
        ToolError: the board failed.
        RecordingError: the file exists, or cannot be written.
    """
    report = Report(f"{tool.name}:{tissue}", library.name, tool.board.sample_rate_hz, force_scale=tool.scale_in_words)
    session = EstimationSession(tool, library, settings)
    source, _ = open_tool(tool, library, tissue, seed, virtual=not real_time)
    run_id = record.stem if record else "run"
    rig = Rig(tool, library, settings)
    recorded = HeadlessFile(record, rig, new_run(run_id, protocol.name, cycles, tissue), protocol) if record else None
    with source, recorded or contextlib.nullcontext() as file:
        hold_back = HoldBack(tool, library, settings.limiter)
        acquisition = Acquisition(source, tool, settings.conditioning, hold_back, Safety.ARMED)
        acquisition.start(run_id, protocol, cycles)
        ended: list[RunEnded] = []
        while not ended:
            block = acquisition.turn()
            assert block is not None, "a tool's samples have no end"
            report.samples += len(block.samples)
            report.lost_samples += block.lost_samples
            estimate = session.process(block)
            if file:
                file.take(block, estimate)
            report.grasps += estimate.ended
            limit = limit_of(estimate.identification)
            acquisition.allow(limit.threshold_n, limit.tick)
            for why in acquisition.take_let_go():
                report.let_go.append(let_go_text(why))
                if file:
                    file.let_go(report.let_go[-1])
            ended = acquisition.take_ended()
            progress(report.samples / tool.board.sample_rate_hz)
        last = session.finish()
        if file:
            file.cut_short(last)
            file.run_ended(RunState(ended[0].end), ended[0].why)
    if last:
        report.grasps.append(last)
    if ended[0].end is RunEnd.FAILED:
        report.failure = f"The run was ended early with the motor at zero: {ended[0].why}."
    return report


def replay_recording(recording: Recording, rig: Rig, progress: Progress) -> Report:
    """Take a recording through calibration, conditioning, estimation and identification.

    Of a recorded run nothing but the run itself is taken, and its estimates are compared with those recorded.

    Raises:
        RecordingError: the file is damaged; names the place.
    """
    tool, library, settings = rig.tool, rig.library, rig.settings
    report = Report(str(recording.path), library.name, tool.board.sample_rate_hz, force_scale=tool.scale_in_words)
    pipeline = Pipeline(tool, settings.conditioning)
    session = EstimationSession(tool, library, settings)
    comparing = Comparing(recording.container, rig, recording.first_tick) if recording.container else None
    recording.skip_to_run()
    with recording:
        while (raw := recording.read_block()) is not None:
            report.samples += len(raw)
            report.lost_samples += raw.lost_samples
            estimate = session.process(pipeline.process(raw))
            report.grasps += estimate.ended
            if comparing:
                comparing.take(estimate.estimates)
            progress(report.samples / recording.samples)
    if last := session.finish():
        report.grasps.append(last)
    report.comparison = comparing.result if comparing else None
    return report
