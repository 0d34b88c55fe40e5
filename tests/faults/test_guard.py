"""A real guard process before a simulated board over TCP; the acquisition is this test, silent when it wants."""

import multiprocessing
import os
import time

import numpy as np
import pytest
import zmq
from faulty import LIBRARY, SETTINGS, TOOL

from acquisition import bus
from acquisition.drivers.nidaq import NidaqSource, create_session_options
from acquisition.notices import Monitoring, MotorNotZeroed, MotorZeroed, Notice, RunEnded, RunOutcome
from acquisition.safety import safety_monitor
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock
from acquisition.simulation.board import RealClock, SimulatedBoard
from acquisition.simulation.grasper import SimulatedGrasper
from acquisition.simulation.service import serve_tcp
from config.schema import ToolKind

BLOCK_S = 0.005
NOTHING = np.zeros(5, SAMPLE_DTYPE)


class GuardedTool:
    """A board whose motor is driven with 1 V, and what the guard tells."""

    def __init__(self, folder) -> None:
        self.board = SimulatedBoard(TOOL, SimulatedGrasper(TOOL, LIBRARY, "bladder", seed=1), RealClock())
        self._server, port = serve_tcp(self.board)
        wiring = TOOL.board.model_copy(update={"grpc_address": f"127.0.0.1:{port}"})
        tool = TOOL.model_copy(update={"kind": ToolKind.NIDAQ, "board": wiring})
        self._source = NidaqSource(tool, create_session_options(tool)).__enter__()
        self._source.write_command(1.0)
        endpoints = bus.Endpoints.in_folder(folder)
        self._context = zmq.Context()
        self.publisher = bus.open_publisher(self._context, endpoints.samples)
        self._told = bus.open_subscriber(self._context, endpoints.safety_monitor)
        context = multiprocessing.get_context("spawn")
        setup = safety_monitor.SafetyMonitorSetup(os.getpid(), endpoints, tool, SETTINGS.realtime)
        self.process = context.Process(target=safety_monitor.main, args=(setup,), daemon=True)
        self.process.start()
        assert self._told.poll(20_000), "the guard says nothing"
        self.publish(Safety.RUNNING, 0.3)

    def publish(self, safety: Safety, for_s: float) -> None:
        """Blocks for a while; silence after."""
        end_s = time.monotonic() + for_s
        while time.monotonic() < end_s:
            block = SampleBlock(1, time.monotonic_ns(), 0, NOTHING, "run", safety)
            self.publisher.send_multipart(bus.pack_samples(block))
            time.sleep(BLOCK_S)

    def wait_for_zero(self, within_s: float) -> None:
        end_s = time.monotonic() + within_s
        while self.board.output_v:
            assert time.monotonic() < end_s, f"the motor is still driven after {within_s} s"
            time.sleep(BLOCK_S)

    def told_until_zeroed(self) -> list[Notice]:
        """What was told before it told that the motor is at zero, without the signs of life."""
        notices: list[Notice] = []
        while not (notices and isinstance(notices[-1], MotorZeroed)):
            assert self._told.poll(1000), f"told only {notices}"
            notices.append(bus.unpack_notice(self._told.recv_multipart()))
        return [notice for notice in notices[:-1] if not isinstance(notice, Monitoring)]

    def close(self) -> None:
        self.process.kill()
        self.process.join()
        self._context.destroy(linger=0)
        self._server.stop(0.2).wait()


pytestmark = pytest.mark.alone  # reaction times are judged


@pytest.fixture
def tool(tmp_path):
    tool = GuardedTool(tmp_path)
    yield tool
    tool.close()


def test_silence_in_a_run_brings_the_motor_to_zero_and_silence_without_one_does_not(tool):
    tool.publish(Safety.ARMED, 0.1)
    time.sleep(0.3)
    assert tool.board.output_v == 1.0
    tool.publish(Safety.RUNNING, 0.1)
    tool.wait_for_zero(0.2)
    assert not tool.told_until_zeroed()


def test_a_reset_that_fails_is_tried_again_until_the_motor_is_at_zero(tool):
    tool.board.disconnect(0.6)
    time.sleep(0.5)
    assert tool.board.output_v == 1.0
    tool.wait_for_zero(0.4)
    failures = tool.told_until_zeroed()
    assert len(failures) > 2
    assert {type(failure) for failure in failures} == {MotorNotZeroed}


def test_a_guard_that_is_to_end_in_a_run_stays_until_the_motor_is_at_zero(tool):
    tool.publish(Safety.RUNNING, 0.1)
    tool.process.terminate()
    tool.publish(Safety.LIMITING, 0.3)
    assert tool.process.is_alive()
    tool.wait_for_zero(0.2)
    tool.process.join(2)
    assert tool.process.exitcode == 0


def test_a_guard_that_is_to_end_leaves_once_the_run_is_over(tool):
    tool.publish(Safety.RUNNING, 0.1)
    tool.publisher.send_multipart(bus.pack_notice(RunEnded("run", RunOutcome.STOPPED, "asked")))
    tool.process.terminate()
    tool.process.join(2)
    assert tool.process.exitcode == 0
    assert tool.board.output_v == 1.0  # who ended the run did that
