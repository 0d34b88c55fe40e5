"""A board that fails: samples that stop, errors, the force that passes what is allowed."""

import pytest
from faulty import AT, LIBRARY, PROTOCOL, SETTINGS, TOOL, Bench, Moment
from nidaqmx.error_codes import DAQmxErrors
from simulation import WatchedGrasper

from acquisition.acquisition_loop import AcquisitionController
from acquisition.drivers.nidaq import NidaqSource
from acquisition.safety.force_limiter import RELEASE_SHARE, ForceLimiter
from acquisition.safety_state_machine import Safety
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.service import create_in_process_options

FLOOR_MS = 15.0
LIMIT_N = SETTINGS.limiter.margin * LIBRARY.lowest_threshold_n


@pytest.mark.parametrize("after", range(6))
@pytest.mark.parametrize("moment", [Moment.RAMP, Moment.HOLD, Moment.RELEASE])
def test_samples_that_stop_bring_the_motor_to_zero_within_15_ms(moment, after, reactions):
    bench = Bench().play(until=AT[moment])
    bench.board.stop_sample_clock(after)
    cut_ns = bench.board.clock.now_ns() + after * 1_000_000
    bench.play()
    assert "in time" in str(bench.error)
    assert bench.board.output_v == 0.0
    took_ms = (bench.board.output_changes[-1].at_ns - cut_ns) / 1e6
    reactions.add("board: samples stop", moment, took_ms, FLOOR_MS)
    assert took_ms <= FLOOR_MS


@pytest.mark.parametrize(
    "code", [DAQmxErrors.SAMPLES_NO_LONGER_AVAILABLE, DAQmxErrors.SAMPLES_NOT_YET_AVAILABLE], ids=["-200279", "-200284"]
)
def test_an_error_of_the_board_brings_the_motor_to_zero_with_that_read(code, reactions):
    bench = Bench().play(until=AT[Moment.HOLD])
    bench.board.fail_next_read(code)
    failed_ns = bench.board.clock.now_ns()
    bench.play()
    assert bench.board.output_v == 0.0
    took_ms = (bench.board.output_changes[-1].at_ns - failed_ns) / 1e6
    reactions.add(f"board: error {int(code)}", Moment.HOLD, took_ms, FLOOR_MS)
    assert took_ms <= FLOOR_MS
    assert "The motor is at zero" in str(bench.error)


@pytest.mark.parametrize("lost_s", [0.05, 2.0])
def test_a_board_that_is_gone_is_told_with_what_to_do_by_hand(lost_s):
    bench = Bench().play(until=AT[Moment.HOLD])
    bench.board.disconnect(lost_s)
    bench.play()
    assert "switch off the motor's amplifier NOW" in str(bench.error)
    assert bench.board.output_v > 0  # nothing can be written to a board that is not there


def test_samples_that_come_late_are_none_that_the_motor_moves_on(reactions):
    """The board delivers nothing for 50 ms, and takes commands all the while."""
    bench = Bench().play(until=AT[Moment.HOLD])
    bench.board.withhold_samples(0.05)
    late_ns = bench.board.clock.now_ns()
    bench.play()
    assert bench.board.output_v == 0.0
    took_ms = (bench.board.output_changes[-1].at_ns - late_ns) / 1e6
    reactions.add("board: samples 50 ms late", Moment.HOLD, took_ms, FLOOR_MS)
    assert took_ms <= FLOOR_MS


@pytest.mark.parametrize(
    ("ceiling_n", "over_n"),
    [(1.2, 1.2), (6.0, RELEASE_SHARE * LIMIT_N), (6.0, LIBRARY.lowest_threshold_n)],
    ids=["ceiling", "limit", "injury threshold"],
)
def test_a_force_that_is_too_large_is_let_go_within_15_ms(ceiling_n, over_n, request, reactions):
    """A tool eight times as strong as its map tells passes any limit before it is known to be."""
    mapping = TOOL.command_to_force
    eightfold = tuple(8.0 * force_n for force_n in mapping.force_n)
    true = TOOL.model_copy(update={"command_to_force": mapping.model_copy(update={"force_n": eightfold})})
    steep = TOOL.plausible.model_copy(update={"strain_step_v": 1.0, "encoder_step_deg": 90.0})  # else: a lost signal
    limits = TOOL.limits.model_copy(update={"force_ceiling_n": ceiling_n})
    tool = TOOL.model_copy(update={"limits": limits, "plausible": steep})
    grasper = WatchedGrasper(true, LIBRARY, "liver", seed=1)
    board = SimulatedBoard(tool, grasper, VirtualClock())
    with NidaqSource(tool, create_in_process_options(board), board.clock.now_ns) as source:
        hold_back = ForceLimiter(tool, LIBRARY, SETTINGS.limiter)
        acquisition = AcquisitionController(source, tool, SETTINGS.conditioning, hold_back, Safety.ARMED)
        acquisition.start("run", PROTOCOL, 1)
        while acquisition.running:
            acquisition.process_block()
    over = next(sample for sample, force_n in enumerate(grasper.forces_n) if force_n > over_n)
    zero = next(
        output.sample_index for output in board.output_changes if output.volts == 0.0 and output.sample_index > over
    )
    reactions.add(f"force over the {request.node.callspec.id}", Moment.RAMP, zero - over, FLOOR_MS)
    assert zero - over <= FLOOR_MS
