"""A board without motor and encoder: a load cell and a potentiometer at jaws that are closed by hand."""

import contextlib

import numpy as np
import pytest
from pydantic import ValidationError

from acquisition.acquisition_loop import AcquisitionController
from acquisition.bench.checks import CheckOutcome
from acquisition.bench.tool_check import HardwareCheck
from acquisition.drivers.nidaq import NidaqSource
from acquisition.notices import RunOutcome
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SampleFlag
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.service import create_in_process_options
from config.errors import RefusedError
from config.load import load_grasp_protocol, load_settings, load_tool
from config.schema import Tool

TOOL = load_tool("usb_daq_example")
OPEN_S, CLOSED_S = 1.0, 0.8
PEAK_N, SHUT_DEG = 4.0, 60.0


class Hand:
    """A hand that closes the jaws for 0.8 s after each second."""

    def __init__(self, noise_v: float = 0.005) -> None:
        self._noise_v, self._random, self._count = noise_v, np.random.default_rng(1), 0

    def step(self, command_v: float) -> dict[str, float]:
        assert command_v == 0.0
        self._count += 1
        phase_s = (self._count / TOOL.board.sample_rate_hz) % (OPEN_S + CLOSED_S) - OPEN_S
        shut = np.sin(np.pi * max(phase_s, 0.0) / CLOSED_S)
        force_v = PEAK_N / 5.0 * max(shut - 0.5, 0.0) / 0.5
        return {
            "strain_v": force_v + self._random.normal(0.0, self._noise_v),
            "encoder_deg": SHUT_DEG * shut + self._random.normal(0.0, 0.1),
        }


def build_source(tool: Tool = TOOL) -> tuple[NidaqSource, VirtualClock]:
    clock = VirtualClock()
    board = SimulatedBoard(tool, Hand(), clock)
    return NidaqSource(tool, create_in_process_options(board), clock.now_ns), clock


def test_grasps_by_hand_are_found_and_nothing_ends_the_run() -> None:
    source, _ = build_source()
    acquisition = AcquisitionController(source, TOOL, load_settings().conditioning)
    with source:
        assert acquisition.safety is Safety.ARMED
        acquisition.start("run", load_grasp_protocol("by_hand"), 1)
        blocks = [acquisition.process_block() for _ in range(1000)]
        assert acquisition.stop("asked to")
        assert acquisition.safety is Safety.ARMED  # nothing has to be armed again
        acquisition.start("another", load_grasp_protocol("by_hand"), 1)
        acquisition.restart_after_reopen("the machine was asleep")
        assert (acquisition.safety, acquisition.why) == (Safety.ARMED, "")
    [ended, failed] = acquisition.pop_ended_runs()
    assert failed.end is RunOutcome.FAILED
    assert ended.end is RunOutcome.STOPPED
    samples = np.concatenate([block.samples for block in blocks if block])
    assert samples["grasp"].max() == int(10.0 / (OPEN_S + CLOSED_S))
    held = samples[samples["flags"] & SampleFlag.IN_GRASP != 0]
    assert held["jaw_force_filtered_n"].max() == pytest.approx(PEAK_N, rel=0.03)
    assert held["jaw_displacement_filtered_m"].max() == pytest.approx(SHUT_DEG * 0.0001, rel=0.03)
    assert np.isnan(samples["motor_command_v"]).all()
    assert np.isnan(samples["limit_n"]).all()


def test_it_takes_no_command() -> None:
    source, _ = build_source()
    with source:
        with pytest.raises(RefusedError, match=r"has no motor\. Choose the protocol 'by_hand'"):
            source.write_command(0.5)
        acquisition = AcquisitionController(source, TOOL, load_settings().conditioning)
        with pytest.raises(RefusedError, match="drives a motor, which this tool lacks"):
            acquisition.start("run", load_grasp_protocol("trapezoid_2hz"), 1)
    motored = load_tool("simulated")
    with pytest.raises(RefusedError, match="is for tools without a motor"):
        AcquisitionController(source, motored, load_settings().conditioning, safety=Safety.ARMED).start(
            "run", load_grasp_protocol("by_hand"), 1
        )


def test_a_position_that_falls_while_the_jaws_close_is_turned_round() -> None:
    position = TOOL.channels.position
    assert position is not None
    backwards = position.model_copy(update={"degree_per_volt": -30.0})
    tool = TOOL.model_copy(update={"channels": TOOL.channels.model_copy(update={"position": backwards})})
    source, _ = build_source(tool)
    with source:
        encoder_deg = np.concatenate([source.read_block().signals["encoder_deg"] for _ in range(180)])
    assert encoder_deg.max() == pytest.approx(SHUT_DEG, abs=1.0)


def test_the_check_leaves_out_what_it_does_not_have() -> None:
    clock = VirtualClock()
    options = create_in_process_options(SimulatedBoard(TOOL, Hand(), clock))
    check = HardwareCheck(TOOL, options, clock.now_ns, contextlib.nullcontext())
    found = {result.check: result for result in check.run_checks(lambda: True)}
    assert found["channels"].text == "2 inputs up to 10 V"
    assert found["motor at zero"].outcome is CheckOutcome.NOT_DONE
    assert found["encoder direction"].text == "the tool has no motor"
    assert found["touch sensors at rest"].text == "the tool has none"
    assert found["sample clock"].outcome is CheckOutcome.PASS


@pytest.mark.parametrize(
    ("channels", "removed", "told"),
    [
        ({"encoder": "ctr0"}, "", r"\[channels\] needs one position sensor"),
        ({"position": None}, "", r"\[channels\] needs one position sensor"),
        ({"strain": ""}, "", "channels.strain is empty"),
        ({}, "hand_driven", r"needs a \[hand_driven\] table"),
        ({"motor_command": "ao0"}, "hand_driven", "motor_command_readback is missing"),
        (
            {"motor_command": "ao0", "motor_command_readback": "ai2"},
            "",
            r"\[hand_driven\] is for tools without a motor",
        ),
    ],
)
def test_parts_that_do_not_fit_are_refused(channels: dict[str, object], removed: str, told: str) -> None:
    content = TOOL.model_dump(exclude={removed})
    content["channels"] |= channels
    with pytest.raises(ValidationError, match=told):
        Tool.model_validate(content)
