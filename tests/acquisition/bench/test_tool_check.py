"""A tool on the bench, walked through the real driver to a simulated board; wiring mistakes are found and named."""

from contextlib import nullcontext

import numpy as np
import pytest

from acquisition.bench.checks import CheckOutcome
from acquisition.bench.jaw_motion import CLOSING_COMMAND_V
from acquisition.bench.tool_check import HardwareCheck
from acquisition.drivers.nidaq import NidaqSource
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.faults import FaultySensors, SensorFault
from acquisition.simulation.grasper import SimulatedGrasper
from acquisition.simulation.service import create_in_process_options
from acquisition.simulation.wiring import MiswiredGrasper, WiringFault
from acquisition.tool_factory import open_hardware_check
from config.load import load_library, load_tool
from config.schema import Tool

TOOL, LIBRARY = load_tool("simulated"), load_library("porcine")


def changed(part: str, **values: object) -> Tool:
    """The shipped tool file with other values in one of its tables."""
    return TOOL.model_copy(update={part: getattr(TOOL, part).model_copy(update=values)})


class Bench:
    """`real` is the tool as it is wired, `file` what its file says."""

    def __init__(
        self, file: Tool = TOOL, real: Tool = TOOL, mistake: WiringFault | None = None, fault: SensorFault | None = None
    ) -> None:
        self.grasper = SimulatedGrasper(real, LIBRARY, "liver", seed=1)
        self.grasper.gauge_m = 0.0
        plant = MiswiredGrasper(self.grasper, mistake) if mistake else FaultySensors(self.grasper, real)
        if fault:
            plant.inject_fault_at(fault, 0)
        self.board = SimulatedBoard(real, plant, VirtualClock())
        self.options = create_in_process_options(self.board)
        self.walk = HardwareCheck(file, self.options, self.board.clock.now_ns)

    def findings(self, move: bool = True) -> dict[str, tuple[CheckOutcome, str]]:
        found = {each.check: (each.outcome, each.text) for each in self.walk.run_checks(lambda: move)}
        assert self.board.output_v == 0.0
        return found


def test_a_tool_that_is_wired_as_its_file_says_passes_every_check():
    bench = Bench()
    found = list(bench.walk.run_checks(lambda: True))
    assert {each.outcome for each in found} == {CheckOutcome.PASS}, found
    figures = {each.check: each.figures for each in found}
    assert figures["sample clock"]["rate_hz"] == pytest.approx(1000.0)
    assert figures["motor command read back"]["gain"] == pytest.approx(1.0, abs=1e-3)
    assert figures["encoder scale"]["deg_per_volt"] == pytest.approx(TOOL.calibration.encoder_deg_per_volt, rel=0.05)
    assert figures["round trip"]["delay_ms"] < 10.0
    assert max(output.volts for output in bench.board.output_changes) == CLOSING_COMMAND_V
    assert bench.board.output_v == 0.0


def test_nothing_moves_before_somebody_agrees():
    bench = Bench()
    found = bench.findings(move=False)
    assert not bench.board.output_changes
    assert found["encoder direction"][0] is CheckOutcome.NOT_DONE
    assert "--move" in found["encoder direction"][1]


MISTAKES = {
    "strain and read-back swapped": (
        {"file": changed("channels", strain="ai2", motor_command_readback="ai0")},
        "strain gage at rest",
        "the motor command read back (ai0) looks like a strain gage: the two are swapped",
    ),
    "strain and touch swapped": (
        {"file": changed("channels", strain="ai3", touch=("ai0", "ai1"))},
        "strain gage at rest",
        "touch sensor 1 (ai0) looks like a strain gage: the two are swapped",
    ),
    "encoder reversed": (
        {"fault": SensorFault.ENCODER_REVERSED},
        "encoder direction",
        "backwards: exchange A and B of ctr0",
    ),
    "encoder not connected": ({"fault": SensorFault.ENCODER_STUCK}, "encoder direction", "check the cable of ctr0"),
    "encoder of half the counts": (
        {"real": changed("calibration", encoder_counts_per_rev=250)},
        "encoder scale",
        "it counts half the pulses",
    ),
    "encoder of twice the counts": (
        {"real": changed("calibration", encoder_counts_per_rev=1000)},
        "encoder scale",
        "it counts twice the pulses",
    ),
    "strain input floats": (
        {"mistake": WiringFault.STRAIN_FLOATS},
        "strain gage at rest",
        "mains hum: nothing drives ai0",
    ),
    "strain amplifier at its rail": (
        {"fault": SensorFault.STRAIN_SATURATED},
        "strain gage at rest",
        "the end of its range: look for a broken wire",
    ),
    "input shorted": ({"fault": SensorFault.STRAIN_DROP_OUT}, "strain gage at rest", "which no amplifier does"),
    "noisy cable": ({"real": changed("noise", strain_sd_v=0.03)}, "strain gage at rest", "check the cable's screen"),
    "another rest voltage": (
        {"real": changed("calibration", rest_offset_v=0.5)},
        "strain gage at rest",
        "`graspwatch calibrate tare`",
    ),
    "motor command not read back": (
        {"mistake": WiringFault.READBACK_OPEN},
        "motor command read back",
        "ai2 stays at zero: it is not connected to ao0",
    ),
    "motor command read back through a divider": (
        {"mistake": WiringFault.READBACK_HALVED},
        "motor command read back",
        "of each volt 0.500 V come back",
    ),
    "no such channel": (
        {"file": changed("channels", strain="ai9")},
        "channels",
        "the board has no ai9: correct the names",
    ),
    "one channel for two signals": (
        {"file": changed("channels", strain="ai2")},
        "channels",
        "ai2 stands for two signals",
    ),
    "no such range": (
        {"file": changed("channels", analog_range_v=2.0)},
        "channels",
        "set `analog_range_v` to one of 0.2, 1, 5, 10 V",
    ),
    "another device name": ({"file": changed("board", device="Dev2")}, "board", "There is no board named Dev2"),
    "another product": (
        {"real": changed("board", product="USB-6009")},
        "board",
        "Dev1 is a USB-6009, the tool file is for a PCI-6230",
    ),
    "a sensor that tells contact": (
        {"mistake": WiringFault.TOUCH_STUCK},
        "touch sensors at rest",
        "which is contact: empty the jaws",
    ),
}


@pytest.mark.parametrize(("bench", "check", "says"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_found_and_named(bench, check, says):
    found = Bench(**bench).findings()
    (first, text), *more = [(name, text) for name, (outcome, text) in found.items() if outcome is CheckOutcome.FAIL]
    assert (first, says in text) == (check, True), text
    assert "swapped" in text or not more, more  # two wires that are exchanged are wrong at both ends


def test_two_programs_on_one_board():
    bench = Bench()
    with NidaqSource(TOOL, bench.options, bench.board.clock.now_ns):
        outcome, text = bench.findings()["board in use"]
    assert outcome is CheckOutcome.FAIL
    assert "Another program uses Dev1" in text


def test_jaws_that_are_not_empty_are_let_go_at_once():
    """A spring ten times as strong as the map tells: more strain than empty jaws come to."""
    mapping = TOOL.command_to_force
    strong = {"force_n": tuple(10.0 * force_n for force_n in mapping.force_n)}
    bench = Bench(real=TOOL.model_copy(update={"command_to_force": mapping.model_copy(update=strong)}))
    found = bench.findings()
    assert "more than empty jaws do" in " ".join(
        text for outcome, text in found.values() if outcome is CheckOutcome.FAIL
    )
    assert max(output.volts for output in bench.board.output_changes) < CLOSING_COMMAND_V
    assert np.isfinite(bench.grasper.force_n)


@pytest.mark.parametrize(
    ("part", "values", "check", "told"),
    [
        ("board", {"device": "Dev2"}, "board", "no board named Dev2"),
        ("board", {"product": "USB-6009"}, "board", "is a PCI-6230, the tool file is for a USB-6009"),
        ("channels", {"strain": "ai8"}, "channels", "the board has no ai8"),
        ("channels", {"encoder": "ctr2"}, "channels", "the board has no ctr2"),
        ("channels", {"motor_command": "ao4"}, "channels", "the board has no ao4"),
        ("channels", {"analog_range_v": 2.5}, "channels", "the board has no range of 2.5 V"),
        ("board", {"sample_rate_hz": 1024.0}, "board in use", "would make 1024.01"),
    ],
)
def test_a_mistake_in_a_file_for_the_simulated_board_is_found_as_on_a_real_one(
    part: str, values: dict[str, object], check: str, told: str
) -> None:
    walk = open_hardware_check(changed(part, **values), LIBRARY, nullcontext())
    found = {each.check: each for each in walk.run_checks(lambda: False)}
    assert found[check].outcome is CheckOutcome.FAIL
    assert told in found[check].text


@pytest.mark.parametrize(
    ("values", "check", "told"),
    [
        ({"strain": "ai4"}, "strain gage at rest", "check that ai4 is the strain gage's channel"),
        ({"motor_command": "ao1"}, "motor command read back", "ai2 stays at zero"),
        ({"encoder": "ctr1"}, "encoder direction", "check the cable of ctr1"),
        ({"motor_command_readback": "ai5"}, "motor command read back", "ai5 stays at zero"),
    ],
)
def test_a_channel_that_the_board_has_but_nothing_is_wired_to_is_found_too(
    values: dict[str, object], check: str, told: str
) -> None:
    found = Bench(file=changed("channels", **values)).findings()
    assert found[check][0] is CheckOutcome.FAIL
    assert told in found[check][1]


def test_a_rate_that_the_board_can_make_is_taken_exactly() -> None:
    tool = changed("board", sample_rate_hz=20e6 / 19531)
    bench = Bench(file=tool)
    assert bench.findings(move=False)["sample clock"][0] is CheckOutcome.PASS
