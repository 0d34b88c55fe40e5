"""What stops the motor, and the rules of what holds it back; what comes of them is in `test_hold_back.py`."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.safety.force_limiter import ActiveThreshold, ForceLimiter, compute_finite_median, find_stop_reason
from acquisition.sample_block import SAMPLE_DTYPE, SampleFlag
from acquisition.signals.grasp_tracker import COMMAND_ON_V
from config.load import load_library, load_settings, load_tool

TOOL = load_tool("simulated")
LIBRARY = load_library("porcine")
LOWEST_N, HIGHEST_N = LIBRARY.lowest_threshold_n, LIBRARY.threshold_n("small_bowel")
CEILING_N = 6.0  # above the highest injury threshold of the paper's tissues, 5.63 N
UNKNOWN = "the force is not known"


def block(force_n: list[float], flags: int | list[int] = SampleFlag.IN_GRASP) -> np.ndarray:
    samples = np.zeros(len(force_n), SAMPLE_DTYPE)
    samples["jaw_force_n"], samples["flags"] = force_n, flags
    return samples


@given(st.lists(st.floats(-20, 20), min_size=1, max_size=20))
def test_the_motor_stops_exactly_when_the_mean_force_of_a_block_passes_the_ceiling(force_n: list[float]) -> None:
    mean_n = sum(force_n) / len(force_n)
    if abs(mean_n - CEILING_N) < 1e-9:  # the order of summation decides
        return
    why = find_stop_reason(TOOL, block(force_n))
    assert (why is not None) == (mean_n > CEILING_N)
    if why:
        assert why == f"force {mean_n:.2f} N is over the ceiling of 6.00 N"


def test_the_ceiling_itself_is_allowed() -> None:
    assert find_stop_reason(TOOL, block([CEILING_N] * 5)) is None


def test_one_spike_of_the_strain_gage_does_not_end_a_grasp_but_five_samples_do() -> None:
    assert find_stop_reason(TOOL, block([1.5, 1.5, 20.0, 1.5, 1.5])) is None
    assert find_stop_reason(TOOL, block([20.0] * 5))


def test_a_push_the_other_way_is_no_grasp_force() -> None:
    assert find_stop_reason(TOOL, block([-10.0] * 5)) is None


@pytest.mark.parametrize("grasp", [SampleFlag.IN_GRASP, 0])
def test_a_saturated_strain_gage_stops_it_whatever_force_it_seems_to_show(grasp: int) -> None:
    assert UNKNOWN in find_stop_reason(TOOL, block([1.0] * 5, SampleFlag.SATURATED | grasp))
    assert UNKNOWN in find_stop_reason(TOOL, block([np.nan] * 5, SampleFlag.SATURATED | SampleFlag.INVALID | grasp))


def test_one_saturated_sample_in_a_block_does_not() -> None:
    assert find_stop_reason(TOOL, block([1.0] * 5, [0, SampleFlag.SATURATED, 0, 0, 0])) is None


def test_in_a_grasp_a_force_that_cannot_be_known_stops_it() -> None:
    assert UNKNOWN in find_stop_reason(TOOL, block([np.nan] * 5, SampleFlag.INVALID | SampleFlag.IN_GRASP))


def test_between_grasps_an_encoder_that_walked_out_of_range_does_not() -> None:
    """The encoder is zeroed only where a grasp starts; until then its angle means nothing."""
    assert find_stop_reason(TOOL, block([np.nan] * 5, SampleFlag.INVALID)) is None


def test_a_bad_sample_does_not_hide_a_force_over_the_ceiling() -> None:
    bad = SampleFlag.IN_GRASP | SampleFlag.INVALID
    assert find_stop_reason(
        TOOL, block([50.0, 50.0, np.nan, 50.0, 50.0], [SampleFlag.IN_GRASP] * 2 + [bad] + [SampleFlag.IN_GRASP] * 2)
    )


# --- the threshold in force ------------------------------------------------------------------------------------------

EXPIRES = 100


@pytest.mark.parametrize(
    ("told_tick", "now", "grasp_start", "counts"),
    [
        (500, 500, 400, True),
        (500, 600, 400, True),
        (500, 601, 400, False),  # stale
        (500, 510, 500, True),
        (500, 510, 501, False),  # of an earlier grasp
        (500, 499, 400, False),  # of a time to come: of another count of samples
    ],
)
def test_a_threshold_counts_while_it_is_fresh_and_of_this_grasp(told_tick, now, grasp_start, counts) -> None:
    threshold = ActiveThreshold((LOWEST_N, 3.4, HIGHEST_N), EXPIRES)
    assert threshold.value_at(now, grasp_start) == LOWEST_N
    threshold.update(3.4, told_tick)
    assert threshold.value_at(now, grasp_start) == (3.4 if counts else LOWEST_N)


@pytest.mark.parametrize("threshold_n", [math.nan, math.inf, -math.inf, 0.0, 0.99 * LOWEST_N, 1.01 * HIGHEST_N])
def test_a_threshold_that_no_tissue_of_the_library_can_have_is_not_followed(threshold_n: float) -> None:
    threshold = ActiveThreshold((LOWEST_N, 3.4, HIGHEST_N), EXPIRES)
    threshold.update(threshold_n, 500)
    assert threshold.value_at(500, 400) == LOWEST_N


@given(st.lists(st.tuples(st.floats(0, 10), st.integers(0, 2000)), max_size=5), st.integers(0, 2000))
def test_the_newest_word_decides_and_the_lowest_is_never_undercut(told: list[tuple[float, int]], now: int) -> None:
    threshold = ActiveThreshold((LOWEST_N, 3.4, HIGHEST_N), EXPIRES)
    for threshold_n, tick in told:
        threshold.update(threshold_n, tick)
    in_force = threshold.value_at(now, 0)
    assert in_force in (LOWEST_N, *(threshold_n for threshold_n, _ in told[-1:]))
    assert LOWEST_N <= in_force <= HIGHEST_N


# --- holding back -----------------------------------------------------------------------------------------------------

ANY_FORCE = st.floats(-20, 20) | st.just(math.nan)


@given(st.lists(ANY_FORCE, min_size=1, max_size=9))
def test_the_middle_force_is_one_that_was_measured_or_none(force_n: list[float]) -> None:
    known = sorted(value for value in force_n if math.isfinite(value))
    middle = compute_finite_median(force_n)
    assert (middle is None) == (not known)
    if known:
        assert sum(value < middle for value in known) <= len(known) / 2
        assert sum(value > middle for value in known) <= len(known) / 2


class Prompt:
    """A limiter whose reader is prompt: each block was taken under the command that the last call returned."""

    def __init__(self) -> None:
        self.hold_back = ForceLimiter(TOOL, LIBRARY, load_settings().limiter)
        self._command_v = 0.0

    def judge(self, samples: np.ndarray, wanted_v: float) -> tuple[float, int]:
        self._command_v, flags = self.hold_back.limit_command(samples, [self._command_v] * len(samples), wanted_v)
        return self._command_v, flags


def in_a_grasp(number: int, force_n: list[float], contact_tick: int) -> np.ndarray:
    samples = block(force_n)
    samples["tick"] = 5 * number + np.arange(5)
    samples["contact_tick"] = contact_tick
    return samples


@given(
    blocks=st.lists(
        st.tuples(st.lists(ANY_FORCE, min_size=5, max_size=5), st.floats(0, TOOL.limits.max_command_v)), max_size=40
    ),
    contact_tick=st.integers(-1, 200),
    told_n=st.floats(allow_nan=True, allow_infinity=True),
)
def test_whatever_is_felt_the_command_is_never_more_than_asked_for_nor_less_than_zero(
    blocks: list[tuple[list[float], float]], contact_tick: int, told_n: float
) -> None:
    prompt, before_v = Prompt(), 0.0
    for number, (force_n, wanted_v) in enumerate(blocks):
        prompt.hold_back.set_threshold(told_n, 5 * number)
        command_v, flags = prompt.judge(in_a_grasp(number, force_n, contact_tick), wanted_v)
        assert 0.0 <= command_v <= wanted_v
        assert (command_v < wanted_v) == bool(flags & SampleFlag.LIMITED)
        assert command_v <= before_v + 0.3 + 1e-6 or wanted_v <= COMMAND_ON_V  # 60 V/s, 5 ms
        before_v = command_v
        if flags & SampleFlag.RELEASED:
            assert command_v == 0.0


def test_a_grasp_that_was_let_go_stays_so_until_the_protocol_asks_for_zero() -> None:
    prompt = Prompt()
    for number in range(40):
        prompt.judge(in_a_grasp(number, [1.5] * 5, 0), 2.0)
    let_go = SampleFlag.LIMITED | SampleFlag.RELEASED
    assert prompt.judge(in_a_grasp(40, [LOWEST_N + 0.01] * 5, 0), 2.0) == (0.0, let_go)
    assert prompt.judge(in_a_grasp(41, [0.0] * 5, 0), 1.0) == (0.0, let_go)
    assert prompt.judge(in_a_grasp(42, [0.0] * 5, -1), 0.0) == (0.0, 0)
    command_v, flags = prompt.judge(in_a_grasp(43, [0.0] * 5, -1), 0.5)
    assert command_v > 0
    assert not flags & SampleFlag.RELEASED


@pytest.mark.parametrize(("share", "is_let_go"), [(1.04, False), (1.06, True)])
def test_a_force_that_passes_the_limit_by_more_than_noise_is_let_go_at_once(share: float, is_let_go: bool) -> None:
    margin = load_settings().limiter.margin
    prompt = Prompt()
    prompt.judge(in_a_grasp(0, [1.5] * 5, 0), 2.0)
    _, flags = prompt.judge(in_a_grasp(1, [share * margin * LOWEST_N] * 5, 0), 2.0)
    assert bool(flags & SampleFlag.RELEASED) is is_let_go


def test_a_limit_that_falls_below_the_force_is_followed_before_the_grasp_is_let_go() -> None:
    prompt = Prompt()
    let_go_at = 0
    for number in range(60):
        prompt.hold_back.set_threshold(HIGHEST_N if number < 30 else LOWEST_N, 5 * number)
        _, flags = prompt.judge(in_a_grasp(number, [0.9 * LOWEST_N] * 5, 0), 2.0)
        let_go_at = let_go_at or (number if flags & SampleFlag.RELEASED else 0)
    assert 50 <= let_go_at <= 52  # 100 ms


def test_a_force_that_is_not_known_lets_nothing_go_and_leaves_the_limit() -> None:
    prompt = Prompt()
    for number in range(40):
        command_v, flags = prompt.judge(in_a_grasp(number, [math.nan] * 5, 0), 3.5)
        assert flags == SampleFlag.LIMITED
    assert command_v == pytest.approx(2.25, abs=0.01)  # what the map tells for 93 % of 1.80 N
