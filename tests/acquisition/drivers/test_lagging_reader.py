"""A reader that lags behind its board, through the real driver: a lag is no wiring fault, and hides none."""

from collections.abc import Callable, Iterable
from itertools import chain, repeat

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition.acquisition_loop import READBACK_TOLERANCE_V, AcquisitionController
from acquisition.bench import fits
from acquisition.bench.calibration_bench import CalibrationBench
from acquisition.drivers.nidaq import NidaqSource
from acquisition.notices import RunOutcome
from acquisition.safety.force_limiter import ForceLimiter
from acquisition.safety_state_machine import Safety
from acquisition.simulation.board import Plant, SimulatedBoard, VirtualClock
from acquisition.simulation.grasper import SimulatedGrasper
from acquisition.simulation.service import create_in_process_options
from config.load import load_grasp_protocol, load_library, load_settings, load_tool

TOOL, LIBRARY, SETTINGS = load_tool("simulated"), load_library("porcine"), load_settings()
PROTOCOL = load_grasp_protocol("trapezoid_2hz")
TURN_NS, BLOCK_NS = 1_000_000, 5_000_000
RISE_V_PER_S = PROTOCOL.waveform.peak_v / PROTOCOL.waveform.ramp_up_s
CYCLES = 3


class LateReader(NidaqSource):
    """Reads each block so long after its last sample, s, or as soon as it comes to it: a turn takes it 1 ms."""

    def __init__(self, board: SimulatedBoard, lags_s: Iterable[float]) -> None:
        super().__init__(TOOL, create_in_process_options(board), board.clock.now_ns)
        self._virtual, self._lags_s, self._due_ns = board.clock, iter(lags_s), 0

    def read_block(self):
        self._due_ns += BLOCK_NS
        wake_ns = self._due_ns + round(next(self._lags_s) * 1e9)
        self._virtual.sleep_until_ns(max(wake_ns, self._virtual.now_ns() + TURN_NS))
        return super().read_block()


class Wiring:
    """A plant whose motor command is read back by `reads(command, strain)` from the midst of the first hold on."""

    def __init__(self, reads: Callable[[float, float], float] = lambda command_v, strain_v: command_v) -> None:
        self._grasper = SimulatedGrasper(TOOL, LIBRARY, "bladder", seed=1)
        self._reads, self._strain_v, self._wrong = reads, 0.0, False
        self.commands_v: list[float] = []

    def step(self, command_v: float) -> dict[str, float]:
        self.commands_v.append(command_v)
        readings = self._grasper.step(command_v)
        self._strain_v = readings["strain_v"]
        return readings

    def readback_v(self, command_v: float) -> float:
        self._wrong = self._wrong or min(self.commands_v[-100:], default=0.0) > 1.5
        return self._reads(command_v, self._strain_v) if self._wrong else command_v


def play(plant: Plant, lags_s: Iterable[float]) -> tuple[SimulatedBoard, np.ndarray, RunOutcome, str]:
    """The board, the samples that were read, and how the run ended, why."""
    board = SimulatedBoard(TOOL, plant, VirtualClock())
    hold_back = ForceLimiter(TOOL, LIBRARY, SETTINGS.limiter)
    with LateReader(board, lags_s) as source:
        acquisition = AcquisitionController(source, TOOL, SETTINGS.conditioning, hold_back, Safety.ARMED)
        acquisition.start("run", PROTOCOL, CYCLES)
        blocks = []
        while acquisition.running:
            blocks.append(acquisition.process_block().samples)
        [ended] = acquisition.pop_ended_runs()
    return board, np.concatenate(blocks), ended.end, ended.why


@pytest.mark.parametrize("lag_s", [0.05, 0.1, 0.2, 0.3, 0.5])
def test_a_reader_that_lags_runs_to_its_end(lag_s):
    _, samples, end, why = play(Wiring(), repeat(lag_s))
    assert end is RunOutcome.FINISHED, why
    assert samples["grasp"].max() == CYCLES
    assert samples["motor_command_v"].max() == pytest.approx(PROTOCOL.waveform.peak_v)


LAGS_S = st.lists(st.tuples(st.integers(1, 200), st.floats(0.0, 0.5)), max_size=12)
"""For so many blocks, so late."""


@given(lags_s=LAGS_S)
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
def test_whatever_holds_the_reader_up_the_run_ends_well_and_the_command_rises_no_faster_than_asked(lags_s):
    plant = Wiring()
    lags = chain(*(repeat(lag_s, blocks) for blocks, lag_s in lags_s), repeat(0.0))
    _, _, end, why = play(plant, lags)
    assert end is RunOutcome.FINISHED, why
    commands_v = np.array(plant.commands_v)
    most_v = RISE_V_PER_S * (0.02 + 0.015)  # in 20 ms: two blocks may come at once, and a write holds for one
    assert (commands_v[20:] - commands_v[:-20]).max() < most_v


MISWIRED = {
    "open": lambda command_v, strain_v: 0.0,
    "stuck": lambda command_v, strain_v: 2.5,
    "through a divider": lambda command_v, strain_v: 0.5 * command_v,
    "gain of 1.3": lambda command_v, strain_v: 1.3 * command_v,
    "another signal": lambda command_v, strain_v: strain_v - 0.5,
    "reversed": lambda command_v, strain_v: -command_v,
    "no number": lambda command_v, strain_v: float("nan"),
}


@pytest.mark.parametrize("lag_s", [0.0, 0.05, 0.2, 0.5])
@pytest.mark.parametrize("wrong", MISWIRED)
def test_a_command_that_is_read_back_wrong_is_found_within_100_ms_of_samples(wrong, lag_s, reactions):
    plant = Wiring(MISWIRED[wrong])
    board, samples, end, why = play(plant, repeat(lag_s))
    assert end is RunOutcome.FAILED
    assert "check its wiring" in why
    assert board.output_v == 0.0
    off_v = np.abs(samples["motor_command_v"] - np.array(plant.commands_v[: len(samples)]))
    off_v[np.isnan(off_v)] = np.inf
    took_ms = int((off_v[::-1] <= READBACK_TOLERANCE_V).argmax())  # samples in a row up to the last one that was read
    reactions.add(f"motor command read back wrong: {wrong}", f"hold, reader {lag_s * 1e3:.0f} ms late", took_ms, 100.0)
    assert 0 < took_ms <= 100


def test_a_reader_that_is_later_than_a_second_ends_the_run_and_calls_it_late():
    board, _, end, why = play(Wiring(), chain(repeat(0.0, 200), repeat(1.2)))
    assert end is RunOutcome.FAILED
    assert "read 1.2 s late" in why
    assert board.output_v == 0.0


@pytest.mark.parametrize("held_up_s", [0.1, 0.5])
def test_a_calibration_whose_program_is_held_up_again_and_again_comes_out_right(held_up_s):
    """Each time after a third of a second, wherever it is: before a read, or between a write and its answer."""
    grasper = SimulatedGrasper(TOOL, LIBRARY, "liver", seed=1)
    board = SimulatedBoard(TOOL, grasper, VirtualClock())
    resumed_ns = 0

    def clock() -> int:
        nonlocal resumed_ns
        if board.clock.now_ns() - resumed_ns > 333_000_000:
            resumed_ns = board.clock.now_ns() + round(held_up_s * 1e9)
            board.clock.sleep_until_ns(resumed_ns)
        return board.clock.now_ns()

    def put(pull_n: float, gauge_m: float) -> None:
        grasper.handle_pull_n, grasper.gauge_m = pull_n, gauge_m

    [stretch] = fits.fit_cable_stretch(
        CalibrationBench(TOOL, create_in_process_options(board), clock, put).sweep_force_on_empty_jaws(), TOOL
    ).constants
    assert stretch.value == pytest.approx(TOOL.calibration.encoder_deg_per_volt, rel=0.01)
    assert board.output_v == 0.0
