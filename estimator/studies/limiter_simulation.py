"""Functions that simulate grasps with the acquisition in the loop: the command depends on the force, as in a run."""

from collections import deque
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np

from acquisition.acquisition_loop import AcquisitionController
from acquisition.bus import ThresholdUpdate
from acquisition.drivers.command_history import AppliedCommand
from acquisition.drivers.source import RawBlock
from acquisition.notices import RunOutcome
from acquisition.protocol_player import ProtocolPlayer
from acquisition.safety.force_limiter import ActiveThreshold, ForceLimiter
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SampleBlock
from acquisition.simulation.grasper import SimulatedGrasper, collect_block
from config.schema import GraspProtocol, Settings, TissueLibrary, Tool, TrapezoidWaveform
from estimator.online_estimator import TissueEstimator
from estimator.studies.limiter_cases import HOLD_S, LimitedCase, ThresholdScenario
from estimator.worker import to_threshold_update

LEAD_IN_S, RAMP_DOWN_S, REST_S = 0.25, 0.1, 0.2
SCRIPTED_DELAY_S = 0.06  # from contact to a scripted threshold: as early as the estimator names a tissue
DELAY_RANGE_BLOCKS = (16, 25)  # 80 to 120 ms, around the time after which a threshold expires


class GrasperSource:
    """A simulated grasper as a source without a board. As on a board, a command acts from the next sample on."""

    def __init__(self, grasper: SimulatedGrasper, block_samples: int) -> None:
        self._grasper, self._block_samples = grasper, block_samples
        self._command_v, self._tick = 0.0, 0
        self.force_n: list[float] = []  # true, sample by sample

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._command_v = 0.0

    def read_block(self) -> RawBlock:
        rows = []
        for _ in range(self._block_samples):
            rows.append(self._grasper.step(self._command_v))
            self.force_n.append(self._grasper.force_n)
        tick, self._tick = self._tick, self._tick + self._block_samples
        return collect_block(rows, [self._command_v] * self._block_samples, tick)

    def write_command(self, command_v: float) -> AppliedCommand:
        self._command_v = command_v
        return AppliedCommand(command_v, self._tick, self._tick)


@dataclass(frozen=True, slots=True)
class LimitedRun:
    """A simulated case: conditioned samples of dtype SAMPLE, the true jaw force and the limiter's threshold, N."""

    samples: np.ndarray
    force_n: np.ndarray
    threshold_n: np.ndarray
    fault: str = ""  # why the run ended early, with the motor at zero afterwards


def build_waveform(case: LimitedCase, tool: Tool) -> TrapezoidWaveform:
    peak_v = float(tool.command_to_force.to_command_v(case.requested_force_n))
    return TrapezoidWaveform(
        shape="trapezoid",
        peak_v=peak_v,
        ramp_up_s=peak_v / case.ramp_v_per_s,
        hold_s=HOLD_S,
        ramp_down_s=RAMP_DOWN_S,
        rest_s=REST_S,
    )


def build_protocol(case: LimitedCase, tool: Tool) -> GraspProtocol:
    return GraspProtocol(name="limited", title="Limited", lead_in_s=LEAD_IN_S, waveform=build_waveform(case, tool))


def build_true_tool(case: LimitedCase, tool: Tool) -> Tool:
    """Return the simulated tool's true properties, which differ from the tool file `tool`."""
    assert tool.simulation is not None
    mapping = tool.command_to_force
    force_n = tuple(case.gain_ratio * force_n for force_n in mapping.force_n)
    noise = tool.noise.model_copy(update={"strain_sd_v": case.noise_factor * tool.noise.strain_sd_v})
    mechanics = tool.simulation
    moved = {
        "spread_scale": case.spread_factor * mechanics.spread_scale,
        "drive_lag_s": case.lag_factor * mechanics.drive_lag_s,
        "contact_lag_s": case.lag_factor * mechanics.contact_lag_s,
    }
    changes = {"command_to_force": mapping.model_copy(update={"force_n": force_n}), "noise": noise}
    return tool.model_copy(update={**changes, "simulation": mechanics.model_copy(update=moved)})


def simulate_limited(case: LimitedCase, tool: Tool, library: TissueLibrary, settings: Settings) -> LimitedRun:
    """Play the case on a new grasper with acquisition and limiter, and with the estimator if the scenario needs it."""
    source = GrasperSource(_create_grasper(case, tool, library), tool.board.block_samples)
    hold_back = ForceLimiter(tool, library, settings.limiter)
    acquisition = AcquisitionController(source, tool, settings.conditioning, hold_back, Safety.ARMED)
    acquisition.start("study", build_protocol(case, tool), case.grasps)
    teller = ThresholdFeed(case, tool, library, settings)
    thresholds_n = library.convert_thresholds_to_displayed_n(tool).values()
    in_force = ActiveThreshold(thresholds_n, round(settings.limiter.limit_expires_s * tool.board.sample_rate_hz))
    blocks, thresholds = [], []
    player = ProtocolPlayer(build_protocol(case, tool), tool, case.grasps)
    while acquisition.running or len(thresholds) < player.total_samples:
        block = acquisition.process_block()
        assert block is not None, "a grasper's samples have no end"
        last = block.samples[-1]
        blocks.append(block.samples)
        thresholds += [in_force.value_at(int(last["tick"]), int(last["grasp_start_tick"]))] * len(block.samples)
        for limit in teller.pop_arrived(block):
            acquisition.set_threshold(limit.threshold_n, limit.tick)
            in_force.update(limit.threshold_n, limit.tick)
    faults = [ended.why for ended in acquisition.pop_ended_runs() if ended.end is RunOutcome.FAILED]
    return LimitedRun(np.concatenate(blocks), np.array(source.force_n), np.array(thresholds), "".join(faults))


def simulate_unlimited_force(case: LimitedCase, tool: Tool, library: TissueLibrary) -> np.ndarray:
    """Return the true jaw force of a case without the limiter, N, sample by sample."""
    source = GrasperSource(_create_grasper(case, tool, library), tool.board.block_samples)
    player = ProtocolPlayer(build_protocol(case, tool), tool, case.grasps)
    while not player.done:
        source.read_block()
        source.write_command(player.next_command(tool.board.block_samples))
    return np.array(source.force_n)


def _create_grasper(case: LimitedCase, tool: Tool, library: TissueLibrary) -> SimulatedGrasper:
    return SimulatedGrasper(build_true_tool(case, tool), library, case.tissue, case.seed, case.deviation)


class ThresholdFeed:
    """Thresholds that reach the limiter after each block."""

    def __init__(self, case: LimitedCase, tool: Tool, library: TissueLibrary, settings: Settings) -> None:
        self._case, self._library = case, library
        self._rate_hz = tool.board.sample_rate_hz
        self._change_tick = (LEAD_IN_S + case.change_s) * self._rate_hz
        estimated = case.scenario in (ThresholdScenario.RIGHT, ThresholdScenario.LATE, ThresholdScenario.DEAD)
        self._estimator = TissueEstimator(tool, library, settings) if estimated else None
        self._in_transit: deque[tuple[int, ThresholdUpdate]] = deque()  # with tick of arrival
        self._rng = np.random.default_rng([case.seed, 3])

    def pop_arrived(self, block: SampleBlock) -> list[ThresholdUpdate]:
        """Return the thresholds that arrive right after this block."""
        last = block.samples[-1]
        tick = int(last["tick"])
        if self._estimator is None:
            return self._create_scripted_updates(tick, int(last["contact_tick"]))
        if self._case.scenario is ThresholdScenario.DEAD and tick > self._change_tick:
            return []
        limit = to_threshold_update(self._estimator.process(block).identification)
        if self._case.scenario is not ThresholdScenario.LATE:
            return [limit]
        delay = len(block.samples) * int(self._rng.integers(*DELAY_RANGE_BLOCKS))
        arrives = max(tick + delay, self._in_transit[-1][0] if self._in_transit else 0)  # in order
        self._in_transit.append((arrives, limit))
        arrived = []
        while self._in_transit and self._in_transit[0][0] <= tick:
            arrived.append(self._in_transit.popleft()[1])
        return arrived

    def _create_scripted_updates(self, tick: int, contact_tick: int) -> list[ThresholdUpdate]:
        if contact_tick < 0 or tick < contact_tick + SCRIPTED_DELAY_S * self._rate_hz:
            return []
        fallen = self._case.scenario is ThresholdScenario.WITHDRAWN and tick > self._change_tick
        threshold_n = (
            self._library.lowest_threshold_n if fallen else self._library.threshold_n(self._case.reported_tissue)
        )
        return [ThresholdUpdate(threshold_n, None, tick)]
