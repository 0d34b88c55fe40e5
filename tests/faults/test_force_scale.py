"""Newtons that are not what they seem: what protects tissue reckons with the upper end of the scale's interval."""

import datetime

import numpy as np
import pytest
from faulty import LIBRARY, PROTOCOL, SETTINGS, TOOL
from simulation import WatchedGrasper

from acquisition.acquisition_loop import AcquisitionController
from acquisition.drivers.nidaq import NidaqSource
from acquisition.safety.force_limiter import ForceLimiter, find_stop_reason
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.service import create_in_process_options
from config.errors import RefusedError
from config.schema import ForceScale, Tool, ToolKind
from estimator.online_estimator import TissueEstimator
from estimator.worker import to_threshold_update

STRONG = PROTOCOL.model_copy(update={"waveform": PROTOCOL.waveform.model_copy(update={"peak_v": 3.5, "hold_s": 1.0})})
TRUE_SCALE = 2.0  # times what the screen shows
LOWEST_N = LIBRARY.lowest_threshold_n


def tool_with(kind: ToolKind = ToolKind.NIDAQ, *, measured: bool = True, **scale: float) -> Tool:
    """A tool whose newtons are Eq. (2)'s, more or less."""
    date = datetime.date(2026, 11, 1) if measured else None
    numbers = {"value": 1.0, "low": 1.0, "high": 1.0} | scale
    stated = ForceScale(**numbers, measured=measured, source="a test", date=date)
    calibration = TOOL.calibration.model_copy(update={"jaw_force_scale": stated})
    return TOOL.model_copy(update={"kind": kind, "calibration": calibration})


def true_tool() -> Tool:
    """Its jaws press with twice the force that its sensors show by Eq. (2)."""
    stated = TOOL.command_to_force
    stronger = stated.model_copy(update={"force_n": tuple(TRUE_SCALE * force_n for force_n in stated.force_n)})
    return tool_with(ToolKind.SIMULATED, value=TRUE_SCALE, low=TRUE_SCALE, high=TRUE_SCALE).model_copy(
        update={"command_to_force": stronger}
    )


def peak_n(tool: Tool) -> tuple[float, np.ndarray]:
    """The highest true force of a strong grasp on a bladder, N, and the samples."""
    grasper = WatchedGrasper(true_tool(), LIBRARY, "bladder", seed=1)
    board = SimulatedBoard(true_tool(), grasper, VirtualClock())
    session, blocks = TissueEstimator(tool, LIBRARY, SETTINGS), []
    with NidaqSource(tool, create_in_process_options(board), board.clock.now_ns) as source:
        limiter = ForceLimiter(tool, LIBRARY, SETTINGS.limiter)
        acquisition = AcquisitionController(source, tool, SETTINGS.conditioning, limiter, Safety.ARMED)
        acquisition.start("run", STRONG, 1)
        while acquisition.running:
            block = acquisition.process_block()
            blocks.append(block.samples)
            limit = to_threshold_update(session.process(block).identification)
            acquisition.set_threshold(limit.threshold_n, limit.tick)
    return max(grasper.forces_n), np.concatenate(blocks)


def test_a_force_twice_the_one_shown_injures_nothing_where_the_interval_reaches_so_far():
    believed_n, _ = peak_n(tool_with())
    assert believed_n > LOWEST_N, "shown newtons are believed, and it injures"
    true_n, samples = peak_n(tool_with(low=0.5, high=TRUE_SCALE))
    assert true_n < LOWEST_N
    limit_n = SETTINGS.limiter.margin * LOWEST_N / TRUE_SCALE
    np.testing.assert_array_equal(samples["limit_n"], limit_n)  # in the newtons that are shown
    assert samples["jaw_force_n"].max() == pytest.approx(limit_n, rel=0.1)


@pytest.mark.parametrize("high", [1.0, 1.5, 20.0])
def test_the_ceiling_is_reached_sooner_the_further_the_interval_reaches(high):
    tool, samples = tool_with(high=high), np.zeros(5, SAMPLE_DTYPE)
    ceiling_n = TOOL.limits.force_ceiling_n / high
    samples["jaw_force_n"] = 0.999 * ceiling_n
    assert find_stop_reason(tool, samples) is None
    samples["jaw_force_n"] = 1.001 * ceiling_n
    assert "over the ceiling" in find_stop_reason(tool, samples)


def test_force_alarms_come_sooner_the_further_the_interval_reaches():
    _, samples = peak_n(tool_with(low=0.5, high=TRUE_SCALE))
    told = {}
    for high in (1.0, TRUE_SCALE):
        session = TissueEstimator(tool_with(low=0.5, high=high), LIBRARY, SETTINGS)
        blocks = [session.process(SampleBlock(1, 0, 0, part)) for part in np.split(samples, range(5, len(samples), 5))]
        told[high] = [alarm for block in blocks for alarm in block.alarms if alarm.priority]
    assert not told[1.0], "0.9 N are far from 2.25 N"
    assert told[TRUE_SCALE][0].threshold_n == pytest.approx(LOWEST_N / TRUE_SCALE)


# --- arming -----------------------------------------------------------------------------------------------------------


def armed(tool: Tool, **how: str) -> Safety:
    board = SimulatedBoard(TOOL, WatchedGrasper(TOOL, LIBRARY, "bladder", seed=1), VirtualClock())
    with NidaqSource(tool, create_in_process_options(board), board.clock.now_ns) as source:
        acquisition = AcquisitionController(
            source, tool, SETTINGS.conditioning, ForceLimiter(tool, LIBRARY, SETTINGS.limiter)
        )
        acquisition.arm(**how)
        for _ in range(300):
            acquisition.process_block()
        return acquisition.safety


def test_a_real_tool_is_armed_with_a_measured_scale_or_for_a_reason():
    unmeasured = tool_with(measured=False, low=0.05)
    with pytest.raises(RefusedError, match="force scale is not measured"):
        armed(unmeasured)
    assert armed(unmeasured, unmeasured_scale_reason="to measure it") is Safety.ARMED
    assert armed(tool_with()) is Safety.ARMED
    assert armed(TOOL) is Safety.ARMED, "simulated newtons are exact"
