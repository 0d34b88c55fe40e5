"""A grasp in virtual time with acquisition and estimator, on a board whose sensors can fail."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from acquisition.acquisition_loop import AcquisitionController
from acquisition.drivers.nidaq import NidaqSource
from acquisition.notices import RunEnded
from acquisition.safety.force_limiter import ForceLimiter
from acquisition.safety_state_machine import Safety
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.faults import FaultySensors
from acquisition.simulation.grasper import SimulatedGrasper
from acquisition.simulation.service import create_in_process_options
from config.errors import ToolError
from config.load import load_grasp_protocol, load_library, load_settings, load_tool
from estimator.estimate_block import GraspRecord
from estimator.online_estimator import TissueEstimator
from estimator.worker import to_threshold_update

TOOL, LIBRARY, SETTINGS = load_tool("simulated"), load_library("porcine"), load_settings()
PROTOCOL = load_grasp_protocol("trapezoid_2hz")
RATE_HZ = TOOL.board.sample_rate_hz
CYCLE = round(PROTOCOL.waveform.cycle_s * RATE_HZ)
LEAD_IN = round(PROTOCOL.lead_in_s * RATE_HZ)


class Moment(StrEnum):
    """Phase of the grasp in which a fault occurs; the 2 Hz trapezoid has 125 ms up, 250 ms hold, 125 ms down."""

    LEAD_IN = "lead-in"
    RAMP = "ramp"
    HOLD = "hold"
    RELEASE = "release"
    REST = "rest"


AT = {
    Moment.LEAD_IN: LEAD_IN - 50,
    Moment.RAMP: LEAD_IN + 100,
    Moment.HOLD: LEAD_IN + 250,
    Moment.RELEASE: LEAD_IN + 430,
    Moment.REST: LEAD_IN + 700,
}


@dataclass
class Bench:
    """A simulated tool with acquisition and estimator; it collects samples and grasps, labels and limits by block."""

    tissue: str = "bladder"
    seed: int = 1
    cycles: int = 3
    sensor_seed: int = 0
    samples: list[np.ndarray] = field(default_factory=list)
    grasps: list[GraspRecord] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)
    limits_n: list[float] = field(default_factory=list)
    ended: list[RunEnded] = field(default_factory=list)
    error: ToolError | None = None

    def __post_init__(self) -> None:
        grasper = SimulatedGrasper(TOOL, LIBRARY, self.tissue, self.seed)
        self.sensors = FaultySensors(grasper, TOOL, self.sensor_seed)
        self.board = SimulatedBoard(TOOL, self.sensors, VirtualClock())
        self.source = NidaqSource(TOOL, create_in_process_options(self.board), self.board.clock.now_ns)
        hold_back = ForceLimiter(TOOL, LIBRARY, SETTINGS.limiter)
        self.acquisition = AcquisitionController(self.source, TOOL, SETTINGS.conditioning, hold_back, Safety.ARMED)
        self.session = TissueEstimator(TOOL, LIBRARY, SETTINGS)

    def play(self, until: int | None = None) -> "Bench":
        """Continue until `until` samples, the run's end or a board error."""
        if not self.acquisition.running and not self.samples:
            self.source.__enter__()
            self.acquisition.start("run", PROTOCOL, self.cycles)
        while self.acquisition.running and not (until and self.sensors.sample_count >= until):
            try:
                self._turn()
            except ToolError as error:
                self.error = error
                break
        self.ended += self.acquisition.pop_ended_runs()
        return self

    def rest(self, blocks: int) -> "Bench":
        """Continue without a run."""
        for _ in range(blocks):
            self._turn()
        return self

    def _turn(self) -> None:
        block = self.acquisition.process_block()
        self.samples.append(block.samples)
        estimate = self.session.process(block)
        limit = to_threshold_update(estimate.identification)
        self.acquisition.set_threshold(limit.threshold_n, limit.tick)
        self.labels.append(estimate.identification.label)
        self.limits_n.append(limit.threshold_n)
        self.grasps += estimate.ended

    @property
    def zero_at(self) -> int:
        """Index of the sample from which the motor command has been zero."""
        assert self.board.output_v == 0.0
        return self.board.output_changes[-1].sample_index if self.board.output_changes else 0
