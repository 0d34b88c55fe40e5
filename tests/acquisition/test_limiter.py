"""What stops the motor."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.blocks import SAMPLE, Flag
from acquisition.limiter import why_stop
from config.load import load_tool

LIMITS = load_tool("simulated").limits
CEILING_N = 6.0  # above the highest injury threshold of the paper's tissues, 5.63 N
UNKNOWN = "the force is not known"


def block(force_n: list[float], flags: int | list[int] = Flag.IN_GRASP) -> np.ndarray:
    samples = np.zeros(len(force_n), SAMPLE)
    samples["jaw_force_n"], samples["flags"] = force_n, flags
    return samples


@given(st.lists(st.floats(-20, 20), min_size=1, max_size=20))
def test_the_motor_stops_exactly_when_the_mean_force_of_a_block_passes_the_ceiling(force_n: list[float]) -> None:
    mean_n = sum(force_n) / len(force_n)
    if abs(mean_n - CEILING_N) < 1e-9:  # the order of summation decides
        return
    why = why_stop(LIMITS, block(force_n))
    assert (why is not None) == (mean_n > CEILING_N)
    if why:
        assert why == f"force {mean_n:.2f} N is over the ceiling of 6.00 N"


def test_the_ceiling_itself_is_allowed() -> None:
    assert why_stop(LIMITS, block([CEILING_N] * 5)) is None


def test_one_spike_of_the_strain_gage_does_not_end_a_grasp_but_five_samples_do() -> None:
    assert why_stop(LIMITS, block([1.5, 1.5, 20.0, 1.5, 1.5])) is None
    assert why_stop(LIMITS, block([20.0] * 5))


def test_a_push_the_other_way_is_no_grasp_force() -> None:
    assert why_stop(LIMITS, block([-10.0] * 5)) is None


@pytest.mark.parametrize("grasp", [Flag.IN_GRASP, 0])
def test_a_saturated_strain_gage_stops_it_whatever_force_it_seems_to_show(grasp: int) -> None:
    assert UNKNOWN in why_stop(LIMITS, block([1.0] * 5, Flag.SATURATED | grasp))
    assert UNKNOWN in why_stop(LIMITS, block([np.nan] * 5, Flag.SATURATED | Flag.INVALID | grasp))


def test_one_saturated_sample_in_a_block_does_not() -> None:
    assert why_stop(LIMITS, block([1.0] * 5, [0, Flag.SATURATED, 0, 0, 0])) is None


def test_in_a_grasp_a_force_that_cannot_be_known_stops_it() -> None:
    assert UNKNOWN in why_stop(LIMITS, block([np.nan] * 5, Flag.INVALID | Flag.IN_GRASP))


def test_between_grasps_an_encoder_that_walked_out_of_range_does_not() -> None:
    """The encoder is zeroed only where a grasp starts; until then its angle means nothing."""
    assert why_stop(LIMITS, block([np.nan] * 5, Flag.INVALID)) is None


def test_a_bad_sample_does_not_hide_a_force_over_the_ceiling() -> None:
    bad = Flag.IN_GRASP | Flag.INVALID
    assert why_stop(LIMITS, block([50.0, 50.0, np.nan, 50.0, 50.0], [Flag.IN_GRASP] * 2 + [bad] + [Flag.IN_GRASP] * 2))
