"""The limit follows the tissue: acquisition and estimator together, as in `graspwatch run`, and what is told of it."""

from dataclasses import dataclass

import numpy as np
import pytest
from grasps import by, conditioned, processed
from simulation import WatchedGrasper

from acquisition.acquisition_loop import AcquisitionController
from acquisition.drivers.nidaq import NidaqSource
from acquisition.protocol_player import ProtocolPlayer
from acquisition.safety.force_limiter import SETPOINT_SHARE, ForceLimiter
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SampleFlag
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.service import create_in_process_options
from config.load import load_grasp_protocol, load_library, load_settings, load_tool
from estimator.constants import FILLED_JAWS_MARGIN_M
from estimator.estimate_block import IdentificationResult
from estimator.online_estimator import TissueEstimator
from estimator.studies.simulated_grasps import without_touch
from estimator.worker import to_threshold_update

TOOL, LIBRARY, SETTINGS = load_tool("simulated"), load_library("porcine"), load_settings()
MARGIN, LOWEST_N = SETTINGS.limiter.margin, LIBRARY.lowest_threshold_n
CYCLES = 4


@dataclass
class Run:
    samples: np.ndarray
    force_n: np.ndarray  # true, sample by sample
    found: list[IdentificationResult]  # block by block
    limit_n: list[float]  # block by block, that a limiter of our own enforces meanwhile

    def before(self, tick: int) -> IdentificationResult:
        """What was known when the command for the block that begins at `tick` was set: a block earlier."""
        return self.found[tick // 5 - 2]


def run(tissue: str, protocol: str = "strong_2hz", seed: int = 1, cycles: int = CYCLES) -> Run:
    grasper = WatchedGrasper(TOOL, LIBRARY, tissue, seed)
    board = SimulatedBoard(TOOL, grasper, VirtualClock())
    session = TissueEstimator(TOOL, LIBRARY, SETTINGS)
    blocks, found, limit_n, command_v = [], [], [], 0.0
    limiter, player = (
        ForceLimiter(TOOL, LIBRARY, SETTINGS.limiter),
        ProtocolPlayer(load_grasp_protocol(protocol), TOOL, cycles),
    )
    with NidaqSource(TOOL, create_in_process_options(board), board.clock.now_ns) as source:
        acquisition = AcquisitionController(
            source, TOOL, SETTINGS.conditioning, ForceLimiter(TOOL, LIBRARY, SETTINGS.limiter), Safety.ARMED
        )
        acquisition.start("run", load_grasp_protocol(protocol), cycles)
        while not acquisition.pop_ended_runs():
            block = acquisition.process_block()
            blocks.append(block.samples)
            found.append(session.process(block).identification)
            limit = to_threshold_update(found[-1])
            acquisition.set_threshold(limit.threshold_n, limit.tick)
            limit_n.append(limiter.limit_n)
            if not player.done:
                on_v = [command_v] * len(block.samples)
                command_v, _ = limiter.limit_command(block.samples, on_v, player.next_command(len(block.samples)))
            limiter.set_threshold(limit.threshold_n, limit.tick)
        assert not acquisition.pop_release_reasons()
    return Run(np.concatenate(blocks), np.array(grasper.forces_n), found, limit_n)


@pytest.fixture(scope="module")
def runs() -> dict[str, Run]:
    return {tissue: run(tissue) for tissue in LIBRARY.tissues}


@pytest.mark.parametrize("tissue", list(LIBRARY.tissues))
def test_no_force_passes_the_tissues_own_threshold_nor_the_one_in_force(runs: dict[str, Run], tissue: str) -> None:
    found = runs[tissue]
    assert found.force_n.max() < LIBRARY.threshold_n(tissue)
    in_force_n = np.repeat([each.threshold_n for each in found.found], 5)
    settled = in_force_n[100:] == in_force_n[:-100]  # a threshold that has just fallen leaves the force 0.1 s
    assert (found.force_n[100 : len(in_force_n)] < in_force_n[100:])[settled].all()


@pytest.mark.parametrize("tissue", ["bladder", "gallbladder"])
def test_soft_tissues_are_held_at_four_fifths_of_their_threshold(runs: dict[str, Run], tissue: str) -> None:
    found = runs[tissue]
    hold_n = found.found[-1].limit_n
    assert hold_n == pytest.approx(1.80, abs=0.005)
    assert found.force_n.max() < hold_n
    for grasp in range(1, CYCLES + 1):
        own = (found.samples["grasp"] == grasp) & (found.samples["flags"] & SampleFlag.LIMITED > 0)
        assert np.median(found.force_n[own]) == pytest.approx(SETPOINT_SHARE * hold_n, rel=0.02)


def test_a_named_liver_gets_its_own_limit_and_one_that_is_not_named_the_lowest() -> None:
    held_at_n = set()
    for seed in range(1, 7):
        found = run("liver", seed=seed, cycles=1)
        told = {each.label for each in found.found if each.in_grasp}
        peak_n = found.force_n.max()
        if told <= {"undecided"}:
            assert peak_n < MARGIN * LOWEST_N
        held_at_n.add(round(peak_n, 1))
    assert {1.7, 2.3} <= held_at_n  # 2.3 N is all that the protocol asks for; liver's limit is 2.70 N


@pytest.mark.parametrize("tissue", list(LIBRARY.tissues))
def test_what_is_told_is_what_the_limiter_does(runs: dict[str, Run], tissue: str) -> None:
    found = runs[tissue]
    for number, each in enumerate(found.found):
        flags = found.samples["flags"][5 * number + 4]
        assert each.limit_n == found.limit_n[number]
        assert {*found.samples["limit_n"][5 * number : 5 * number + 5]} == {each.limit_n}
        assert each.holding_back == bool(flags & SampleFlag.LIMITED)
    assert any(each.holding_back for each in found.found)
    assert not found.found[-1].holding_back


def test_before_the_force_is_held_the_limit_is_foreseen(runs: dict[str, Run]) -> None:
    for tissue in ("bladder", "gallbladder"):
        found = runs[tissue]
        held = int(np.flatnonzero(found.samples["flags"] & SampleFlag.LIMITED)[0])
        assert 0.0 < found.before(held).time_to_limit_s < 0.1
        later = found.found[held // 5 + 40 : held // 5 + 60]  # 0.2 s later the force is held
        assert [each.time_to_limit_s for each in later] == [None] * 20


def test_a_limit_that_rises_is_told_as_it_rises_and_differs_from_the_threshold_meanwhile(runs: dict[str, Run]) -> None:
    found = runs["small_bowel"]
    rising = [each for each in found.found if each.limit_n < 0.99 * MARGIN * each.threshold_n]
    assert len(rising) > 10
    assert len({each.limit_n for each in rising}) > 10


def test_the_sine_of_the_paper_is_held_at_its_tops_and_nowhere_else() -> None:
    """It asks for 2.0 N, which no unnamed tissue gets."""
    found = run("gallbladder", "sine", cycles=1)
    held = found.samples["flags"] & SampleFlag.LIMITED > 0
    assert found.force_n.max() < MARGIN * LOWEST_N
    commanded_n = TOOL.command_to_force.to_force_n(found.samples["motor_command_v"][held])
    assert commanded_n.min() > 0.75 * MARGIN * LOWEST_N
    assert 0.1 < held.mean() < 0.3


# --- thickness --------------------------------------------------------------------------------------------------------


def thickness_m(samples: np.ndarray, tool=TOOL, settings=SETTINGS) -> float | None:
    blocks, _ = processed(TissueEstimator(tool, LIBRARY, settings), samples, by(samples, 5))
    held = [block.identification.thickness_m for block in blocks if block.identification.in_contact]
    assert len(set(held)) == 1
    before = [block.identification.thickness_m for block in blocks if block.identification.grasp == 0]
    assert set(before) == {None}
    return held[0]


@pytest.mark.parametrize("used", [True, False])
def test_the_thickness_at_contact_is_told_whether_or_not_it_is_evidence(used: bool) -> None:
    identification = SETTINGS.identification.model_copy(update={"use_thickness": used})
    settings = SETTINGS.model_copy(update={"identification": identification})
    for seed in range(3):
        for tissue in ("liver", "small_bowel"):
            samples, specimen = conditioned(TOOL, LIBRARY, SETTINGS, load_grasp_protocol("trapezoid_2hz"), tissue, seed)
            if TOOL.geometry.opening_m - specimen.thickness_m > 2 * FILLED_JAWS_MARGIN_M:
                # a touch is told a sample late, up to 0.1 mm at 100 mm/s; the strain noise adds to it
                assert thickness_m(samples, settings=settings) == pytest.approx(specimen.thickness_m, abs=0.2e-3)


def test_no_thickness_is_told_that_nobody_can_know() -> None:
    fast = load_grasp_protocol("trapezoid_2hz")
    filling, _ = conditioned(TOOL, LIBRARY, SETTINGS, fast, "bladder")
    assert thickness_m(filling) is None  # the jaws do not open further
    liver, _ = conditioned(TOOL, LIBRARY, SETTINGS, fast, "liver")
    assert thickness_m(liver) is not None
    held_before = liver.copy()
    held_before["touch_1_v"] = 5.0
    assert thickness_m(held_before) is None
    blind = without_touch(TOOL)
    assert thickness_m(conditioned(blind, LIBRARY, SETTINGS, fast, "liver")[0], blind) is None
    wide = TOOL.model_copy(update={"geometry": TOOL.geometry.model_copy(update={"opening_m": None})})
    assert thickness_m(liver, wide) is None
