"""A worker that was held up: an error of the board that the delay has caused is mended, any other one is raised."""

import multiprocessing
from collections.abc import Iterator

import pytest
import zmq

from acquisition.acquisition_loop import AcquisitionController
from acquisition.drivers.nidaq import NidaqSource, reset_device
from acquisition.safety_state_machine import Safety
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.grasper import SimulatedGrasper
from acquisition.simulation.service import create_in_process_options
from acquisition.worker import StallDetector, wait_until_tool_may_open
from acquisition.worker_process import ProcessEndFlag
from config.errors import ToolError
from config.load import load_grasp_protocol, load_library, load_settings, load_tool

TOOL = load_tool("simulated")
BLOCK_S = 0.005


class Rig:
    """A run under way on a simulated board, read by the detector; all on one virtual clock."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        grasper = SimulatedGrasper(TOOL, load_library("porcine"), "liver", seed=1)
        self.board = SimulatedBoard(TOOL, grasper, self.clock)
        self.options = create_in_process_options(self.board)
        self.source = NidaqSource(TOOL, self.options, self.clock.now_ns)

    def start(self, publisher: zmq.Socket) -> None:
        settings = load_settings()
        self.acquisition = AcquisitionController(self.source, TOOL, settings.conditioning, safety=Safety.ARMED)
        self.detector = StallDetector(self.source, self.acquisition, publisher, lambda: self.clock.now_ns() * 1e-9)
        self.acquisition.start("a", load_grasp_protocol("trapezoid_2hz"), 20)
        self.read(150)
        while self.board.output_v == 0.0:
            self.read(1)

    def read(self, blocks: int) -> list[int]:
        """Return how many samples were lost before each block."""
        return [self.detector.process_block().lost_samples for _ in range(blocks)]

    def hold_up(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(seconds * 1e9))


@pytest.fixture
def rig() -> Iterator[Rig]:
    rig = Rig()
    with zmq.Context() as context, context.socket(zmq.PUB) as publisher, rig.source:
        rig.start(publisher)
        yield rig


def test_the_tool_is_opened_after_the_signal_and_not_after_the_death_of_the_service() -> None:
    """At the death of the server the kernel closes its end of the pipe before it sends any signal."""
    stop = ProcessEndFlag.__new__(ProcessEndFlag)  # without its signal handlers
    stop.is_set = False
    reader, sender = multiprocessing.Pipe(duplex=False)
    sender.send(None)
    assert [wait_until_tool_may_open(reader, stop) for _ in range(2)] == [True, True], "it stays for the next worker"
    sender.close()
    assert not wait_until_tool_may_open(reader, stop)
    reader, sender = multiprocessing.Pipe(duplex=False)
    sender.close()
    assert not wait_until_tool_may_open(reader, stop)
    reader, sender = multiprocessing.Pipe(duplex=False)
    sender.send(None)
    stop.is_set = True
    assert not wait_until_tool_may_open(reader, stop)


@pytest.mark.parametrize("blocks_before_the_error", [0, 1, 3])
def test_the_board_is_opened_again_when_it_was_reset_during_a_delay(rig: Rig, blocks_before_the_error: int) -> None:
    """The safety monitor resets a board after 60 ms; answers that were under way still arrive."""
    rig.hold_up(0.08)
    rig.read(blocks_before_the_error)
    reset_device(TOOL, rig.options)
    rig.read(50)
    [ended] = rig.acquisition.pop_ended_runs()
    assert "held up for 0.1 s" in ended.why
    assert rig.board.output_v == 0.0


def test_samples_that_were_overwritten_during_a_delay_are_counted(rig: Rig) -> None:
    rig.hold_up(30)
    lost = rig.read(1)
    assert lost == pytest.approx([30_000], abs=10)
    assert not any(rig.read(50))


def test_an_error_long_after_a_delay_is_raised(rig: Rig) -> None:
    rig.hold_up(0.08)
    rig.read(round(1.2 / BLOCK_S))
    reset_device(TOOL, rig.options)
    with pytest.raises(ToolError):
        rig.read(1)


def test_a_second_error_right_after_opening_again_is_raised(rig: Rig) -> None:
    rig.hold_up(0.08)
    reset_device(TOOL, rig.options)
    rig.read(1)
    reset_device(TOOL, rig.options)
    with pytest.raises(ToolError):
        rig.read(1)
