"""An estimator that is late, or whose filters diverge."""

import numpy as np
import pytest
from faulty import AT, LIBRARY, PROTOCOL, SETTINGS, TOOL, Bench, Moment
from simulation import WatchedGrasper

from acquisition.acquisition_loop import AcquisitionController
from acquisition.drivers.nidaq import NidaqSource
from acquisition.safety.force_limiter import ForceLimiter
from acquisition.safety_state_machine import Safety
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.service import create_in_process_options

STRONG = PROTOCOL.model_copy(update={"waveform": PROTOCOL.waveform.model_copy(update={"peak_v": 3.5, "hold_s": 1.0})})
HOLD_N = SETTINGS.limiter.margin * LIBRARY.lowest_threshold_n


@pytest.mark.parametrize(("late", "is_held"), [(0, False), (120, True)], ids=["in time", "120 ms late"])
def test_a_limit_that_comes_100_ms_late_does_not_count(late, is_held):
    """Of a liver, which bears more than the lowest limit: told in time it is followed."""
    grasper = WatchedGrasper(TOOL, LIBRARY, "liver", seed=1)
    board = SimulatedBoard(TOOL, grasper, VirtualClock())
    with NidaqSource(TOOL, create_in_process_options(board), board.clock.now_ns) as source:
        hold_back = ForceLimiter(TOOL, LIBRARY, SETTINGS.limiter)
        acquisition = AcquisitionController(source, TOOL, SETTINGS.conditioning, hold_back, Safety.ARMED)
        acquisition.start("run", STRONG, 1)
        while acquisition.running:
            block = acquisition.process_block()
            tick = int(block.samples["tick"][-1]) - late
            acquisition.set_threshold(LIBRARY.threshold_n("liver"), tick)
    assert (max(grasper.forces_n) < 1.05 * HOLD_N) is is_held


DIVERGENCES = {
    "no number": lambda state: state.mean.fill(np.nan),
    "no variance": lambda state: state.cov.fill(np.nan),
    "run away": lambda state: state.mean.fill(1e9),
}


@pytest.mark.parametrize("diverge", DIVERGENCES.values(), ids=DIVERGENCES)
def test_filters_that_diverge_name_nothing_and_the_next_grasp_is_named_again(diverge):
    """All of them, in the hold of a small bowel, which bears more than the lowest limit."""
    bench = Bench("small_bowel", seed=2, cycles=2).play(until=AT[Moment.HOLD])
    assert bench.labels[-1] == "small_bowel"
    assert bench.limits_n[-1] > LIBRARY.lowest_threshold_n
    diverge(bench.session.bank.state)
    begin = len(bench.labels)
    bench.play(until=AT[Moment.REST])
    assert {*bench.labels[begin + 1 :]} <= {"undecided", "unknown"}
    assert {*bench.limits_n[begin + 1 :]} == {LIBRARY.lowest_threshold_n}
    assert not bench.session.bank.state.valid.any()
    bench.play()
    assert [ended.end.value for ended in bench.ended] == ["finished"]
    assert [grasp.label in ("undecided", "unknown") for grasp in bench.grasps] == [True, False]
    assert bench.grasps[1].label == "small_bowel"


def test_a_tissue_whose_filters_diverge_leaves_the_others_working():
    bench = Bench("bladder", cycles=1).play(until=AT[Moment.RAMP])
    state = bench.session.bank.state
    tissues, bladder = len(LIBRARY.tissues), list(LIBRARY.tissues).index("bladder")
    wrong = [k for k in range(len(state.mean)) if k % tissues == (bladder + 1) % tissues]
    state.mean[wrong] = np.nan
    bench.play(until=AT[Moment.HOLD])
    assert not state.valid[wrong].any()
    bench.play()
    assert [grasp.label for grasp in bench.grasps] == ["bladder"]
