"""A run on the simulated board through the real driver: who stops the motor, and that it is at zero then."""

import numpy as np
import pytest

from acquisition.acquisition_loop import AcquisitionController
from acquisition.drivers.nidaq import NidaqSource
from acquisition.notices import RunOutcome
from acquisition.safety_state_machine import Safety
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.grasper import SimulatedGrasper
from acquisition.simulation.service import create_in_process_options
from config.errors import RefusedError, ToolError
from config.load import load_grasp_protocol, load_library, load_settings, load_tool

TOOL, SETTINGS = load_tool("simulated"), load_settings()
PROTOCOL = load_grasp_protocol("trapezoid_2hz")


def rig(tool=TOOL):
    grasper = SimulatedGrasper(tool, load_library("porcine"), "liver", seed=1)
    board = SimulatedBoard(tool, grasper, VirtualClock())
    return board, NidaqSource(tool, create_in_process_options(board), board.clock.now_ns)


def turns(acquisition, count):
    return np.concatenate([acquisition.process_block().samples for _ in range(count)])


def test_a_run_plays_its_cycles_and_ends_with_the_motor_at_zero():
    board, source = rig()
    with source:
        acquisition = AcquisitionController(source, TOOL, SETTINGS.conditioning, safety=Safety.ARMED)
        acquisition.start("a", PROTOCOL, 2)
        samples = turns(acquisition, 700)
        assert samples["grasp"].max() == 2
        assert samples["motor_command_v"].max() == pytest.approx(2.0)
        (ended,) = acquisition.pop_ended_runs()
        assert (ended.run_id, ended.end) == ("a", RunOutcome.FINISHED)
        assert not acquisition.running
        assert board.output_v == 0.0


def test_the_force_ceiling_ends_the_run_within_three_blocks_of_the_sample():
    tool = TOOL.model_copy(update={"limits": TOOL.limits.model_copy(update={"force_ceiling_n": 1.0})})
    board, source = rig(tool)
    with source:
        acquisition = AcquisitionController(source, tool, SETTINGS.conditioning, safety=Safety.ARMED)
        acquisition.start("a", PROTOCOL, 3)
        samples = turns(acquisition, 600)
        (ended,) = acquisition.pop_ended_runs()
        assert ended.end is RunOutcome.FAILED
        assert "ceiling of 1.00 N" in ended.why
        over = 5 * int(np.flatnonzero(samples["jaw_force_n"].reshape(-1, 5).mean(axis=1) > 1.0)[0])
        assert samples["motor_command_v"][over] > 0
        assert not samples["motor_command_v"][over + 15 :].any()
        assert board.output_v == 0.0


def test_stop_zeroes_the_motor_at_once_and_says_whether_there_was_a_run():
    board, source = rig()
    with source:
        acquisition = AcquisitionController(source, TOOL, SETTINGS.conditioning, safety=Safety.ARMED)
        acquisition.start("a", PROTOCOL, 3)
        turns(acquisition, 140)
        assert board.output_v > 0
        assert acquisition.stop("asked")
        assert board.output_v == 0.0
        assert not acquisition.stop("asked again")
        assert not turns(acquisition, 10)["motor_command_v"][5:].any()


def test_a_second_run_is_refused_and_the_first_goes_on():
    _, source = rig()
    with source:
        acquisition = AcquisitionController(source, TOOL, SETTINGS.conditioning, safety=Safety.ARMED)
        acquisition.start("a", PROTOCOL, 1)
        with pytest.raises(RefusedError, match="under way"):
            acquisition.start("b", PROTOCOL, 1)
        turns(acquisition, 400)
        assert [ended.run_id for ended in acquisition.pop_ended_runs()] == ["a"]


def test_a_failing_board_leaves_the_motor_at_zero():
    board, source = rig()
    with source:
        acquisition = AcquisitionController(source, TOOL, SETTINGS.conditioning, safety=Safety.ARMED)
        acquisition.start("a", PROTOCOL, 1)
        turns(acquisition, 140)
        assert board.output_v > 0
        board.stop_sample_clock(2)
        with pytest.raises(ToolError):
            turns(acquisition, 10)
        assert board.output_v == 0.0


def test_every_run_is_tared_anew():
    _, source = rig()
    with source:
        acquisition = AcquisitionController(source, TOOL, SETTINGS.conditioning, safety=Safety.ARMED)
        acquisition.start("a", PROTOCOL, 1)
        samples = turns(acquisition, 400)
        rest = samples["jaw_force_n"][250:480]  # tared, before the command leaves zero
        assert abs(rest.mean()) < 4 * 0.0124 / np.sqrt(200)


def test_a_strain_gage_that_cannot_be_tared_ends_the_run_before_the_motor_moves():
    calibration = TOOL.calibration.model_copy(update={"rest_offset_v": 0.5})  # the board's gage rests at 0.82 V
    _, source = rig()
    drifted = TOOL.model_copy(update={"calibration": calibration})
    with source:
        acquisition = AcquisitionController(source, drifted, SETTINGS.conditioning, safety=Safety.ARMED)
        acquisition.start("a", PROTOCOL, 1)
        samples = turns(acquisition, 300)
        (ended,) = acquisition.pop_ended_runs()
        assert ended.end is RunOutcome.FAILED
        assert "not tared" in ended.why
        assert not samples["motor_command_v"].any()
