"""An estimator that is late, or whose filters diverge."""

import numpy as np
import pytest
from faulty import AT, LIBRARY, PROTOCOL, SETTINGS, TOOL, Bench, Moment
from simulation import WatchedGrasper

from acquisition.control import Acquisition
from acquisition.limiter import HoldBack
from acquisition.nidaq import NidaqTool
from acquisition.safety import Safety
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.service import in_process_options
from estimator.session import EstimationSession

STRONG = PROTOCOL.model_copy(update={"waveform": PROTOCOL.waveform.model_copy(update={"peak_v": 3.5, "hold_s": 1.0})})
HOLD_N = SETTINGS.limiter.margin * LIBRARY.lowest_threshold_n


@pytest.mark.parametrize(("late", "is_held"), [(0, False), (120, True)], ids=["in time", "120 ms late"])
def test_a_limit_that_comes_100_ms_late_does_not_count(late, is_held):
    """Of a liver, which bears more than the lowest limit: told in time it is followed."""
    grasper = WatchedGrasper(TOOL, LIBRARY, "liver", seed=1)
    board = SimulatedBoard(TOOL, grasper, VirtualClock())
    with NidaqTool(TOOL, in_process_options(board), board.clock.now_ns) as source:
        hold_back = HoldBack(TOOL, LIBRARY, SETTINGS.limiter)
        acquisition = Acquisition(source, TOOL, SETTINGS.conditioning, hold_back, Safety.ARMED)
        acquisition.start("run", STRONG, 1)
        while acquisition.running:
            block = acquisition.turn()
            tick = int(block.samples["tick"][-1]) - late
            acquisition.allow(LIBRARY.threshold_n("liver"), tick)
    assert (max(grasper.forces_n) < 1.05 * HOLD_N) is is_held


def test_filters_that_diverge_are_left_out_and_name_nothing(monkeypatch):
    """Every filter's state is made no number in the midst of a grasp."""
    bench = Bench("bladder", cycles=2).play(until=AT[Moment.RAMP])
    bench.session.bank.state.mean[:] = np.nan
    bench.play()
    assert bench.labels <= {"bladder", "undecided", "unknown"}
    assert len(bench.grasps) >= 1
    assert bench.grasps[0].label != "liver"
    assert isinstance(bench.session, EstimationSession)
