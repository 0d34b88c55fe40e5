"""When the force will be at its limit, if it goes on as it does."""

import math

import numpy as np
import pytest
from grasps import by, conditioned, processed
from hypothesis import given
from hypothesis import strategies as st

from config.load import load_library, load_settings, load_tool
from config.schema import CustomWaveform, GraspProtocol
from estimator.forecast import FORECAST_HORIZON_S, LEVEL_SAMPLES, ForceForecast
from estimator.online_estimator import TissueEstimator

RATE_HZ, NOISE_N = 1000.0, 0.0124  # of a sample, at 2 mV
FORECAST = ForceForecast(RATE_HZ)
LIMIT_N = 2.0


def line(last_n: float, slope_n_per_s: float) -> np.ndarray:
    """Forces on a straight line up to the last one."""
    return last_n + slope_n_per_s * np.arange(1 - FORECAST.window_samples, 1) / RATE_HZ


@given(last_n=st.floats(0, 1.999), slope=st.floats(1.5, 100), noise_n=st.floats(0, NOISE_N))
def test_on_a_straight_line_the_time_is_exact(last_n: float, slope: float, noise_n: float) -> None:
    told_s = FORECAST.forecast_time_to_limit_s(line(last_n, slope), LIMIT_N, noise_n)
    expected_s = (LIMIT_N - last_n) / slope
    assert told_s == pytest.approx(expected_s, rel=1e-6, abs=1e-9)


@given(last_n=st.floats(-5, 5), slope=st.floats(-100, 100), limit_n=st.floats(0.1, 10), noise_n=st.floats(0, 1))
def test_it_is_zero_over_the_limit_none_without_a_rise_and_else_within_two_seconds(
    last_n: float, slope: float, limit_n: float, noise_n: float
) -> None:
    force_n = line(last_n, slope)
    told_s = FORECAST.forecast_time_to_limit_s(force_n, limit_n, noise_n)
    if force_n[-LEVEL_SAMPLES:].mean() > limit_n + 1e-9:
        assert told_s == 0.0
    elif slope < 0 and force_n[-LEVEL_SAMPLES:].mean() < limit_n - 1e-9:
        assert told_s is None
    elif told_s is not None:
        assert 0.0 <= told_s <= FORECAST_HORIZON_S


@given(slope=st.floats(2, 50), first=st.floats(0.1, 2), more=st.floats(0, 1))
def test_a_higher_limit_is_reached_later_and_a_steeper_rise_gets_there_sooner(
    slope: float, first: float, more: float
) -> None:
    at_s = FORECAST.forecast_time_to_limit_s(line(0.0, slope), first, NOISE_N)
    later_s = FORECAST.forecast_time_to_limit_s(line(0.0, slope), first + more, NOISE_N)
    sooner_s = FORECAST.forecast_time_to_limit_s(line(0.0, 2 * slope), first, NOISE_N)
    assert sooner_s <= at_s <= later_s


@pytest.mark.parametrize("slope", [-10.0, 0.0, 0.05])
def test_what_does_not_rise_or_not_within_two_seconds_is_not_foreseen(slope: float) -> None:
    assert FORECAST.forecast_time_to_limit_s(line(1.0, slope), LIMIT_N, 0.0) is None


@given(at=st.integers(0, FORECAST.window_samples - 1))
def test_a_missing_force_is_no_forecast(at: int) -> None:
    force_n = line(1.0, 5.0)
    force_n[at] = math.nan
    assert FORECAST.forecast_time_to_limit_s(force_n, LIMIT_N, NOISE_N) is None


def test_noise_alone_is_no_rise_and_leaves_a_real_one_where_it_is() -> None:
    noise_n = np.random.default_rng(1).normal(0.0, NOISE_N, (20_000, FORECAST.window_samples))
    flat = [FORECAST.forecast_time_to_limit_s(1.8 + row, LIMIT_N, NOISE_N) for row in noise_n]
    assert sum(told is not None for told in flat) <= 4  # four standard deviations, one-sided: 0.6 expected
    rising = [FORECAST.forecast_time_to_limit_s(line(1.0, 5.0) + row, LIMIT_N, NOISE_N) for row in noise_n[:1000]]
    assert np.mean(rising) == pytest.approx(0.2, rel=0.01)
    assert np.std(rising) < 0.01


# --- in a session ----------------------------------------------------------------------------------------------------

TOOL, LIBRARY, SETTINGS = load_tool("simulated"), load_library("porcine"), load_settings()
SOFT = LIBRARY.model_copy(  # 1.35 N, so that a slow ramp passes it
    update={"tissues": {k: v.model_copy(update={"threshold_pa": 24e3}) for k, v in LIBRARY.tissues.items()}}
)


RAMP = GraspProtocol(  # 1.5 N/s beyond 0.8 N
    name="ramp",
    title="Ramp",
    waveform=CustomWaveform(
        shape="custom", time_s=(0.0, 0.1, 0.6, 0.9, 1.0), command_v=(0.0, 0.5, 2.0, 2.0, 0.0), rest_s=0.5
    ),
)


@pytest.mark.parametrize("tissue", ["liver", "gallbladder"])
def test_a_slow_ramp_is_foreseen_with_the_moment_at_which_it_passes_the_limit(tissue: str) -> None:
    samples, _ = conditioned(TOOL, SOFT, SETTINGS, RAMP, tissue)
    samples["limit_n"] = SOFT.lowest_threshold_n
    blocks, _ = processed(TissueEstimator(TOOL, SOFT, SETTINGS), samples, by(samples, 5))
    told = {found.tick: found.time_to_limit_s for found in (block.identification for block in blocks)}
    smooth_n = np.convolve(samples["jaw_force_n"], np.full(5, 0.2), "same")
    over = int(samples["tick"][np.flatnonzero(smooth_n > SOFT.lowest_threshold_n)[0]])
    for ahead in (150, 100, 50):  # whole blocks; a slope of 50 ms is good to 15 % here
        assert told[over // 5 * 5 - 1 - ahead] == pytest.approx((ahead + over % 5) / 1000, rel=0.4, abs=0.01)
    at_rest = [time_s for tick, time_s in told.items() if tick < samples["grasp_start_tick"].max()]
    assert set(at_rest) == {None}
    assert told[over + 219 - over % 5] == 0.0
    assert told[max(told)] is None


def test_nothing_is_foreseen_where_nothing_limits_the_force() -> None:
    samples, _ = conditioned(TOOL, SOFT, SETTINGS, RAMP, "gallbladder")
    blocks, _ = processed(TissueEstimator(TOOL, SOFT, SETTINGS), samples, by(samples, 5))
    assert {(block.identification.limit_n, block.identification.time_to_limit_s) for block in blocks} == {(None, None)}
    assert [grasp.peak_share_of_limit for block in blocks for grasp in block.ended] == [None]


def test_a_gap_in_the_samples_is_no_forecast() -> None:
    samples, _ = conditioned(TOOL, SOFT, SETTINGS, RAMP, "gallbladder")
    samples["limit_n"] = SOFT.lowest_threshold_n
    middle = int(np.flatnonzero(samples["jaw_force_n"] > 1.1)[0]) // 5 * 5
    cut = np.delete(samples, slice(middle, middle + 5))
    blocks, _ = processed(TissueEstimator(TOOL, SOFT, SETTINGS), cut, by(cut, 5))
    told = [block.identification.time_to_limit_s for block in blocks if middle < block.identification.tick]
    assert told[:9] == [None] * 9
    assert told[10] is not None
