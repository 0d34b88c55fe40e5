"""The paper's 10 Hz Butterworth filter, against SciPy's second-order sections and its own mathematics."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from acquisition.signals.low_pass import LowPassFilter
from config.schema import ConditioningSettings

RATE_HZ = 1000.0
CUTS = st.lists(st.integers(1, 299), max_size=12)


def walk(seed: int, samples: int = 300) -> np.ndarray:
    return 0.8 + np.cumsum(np.random.default_rng(seed).standard_normal((2, samples)), axis=1)


@given(st.integers(0, 1000), st.integers(1, 4), st.floats(5.0, 100.0))
def test_it_is_the_butterworth_filter_of_its_order_and_cutoff(seed: int, order: int, cutoff_hz: float) -> None:
    settings = ConditioningSettings(butterworth_order=order, butterworth_cutoff_hz=cutoff_hz)
    values = walk(seed)
    sections = signal.butter(order, cutoff_hz, fs=RATE_HZ, output="sos")
    begin = signal.sosfilt_zi(sections)[:, None, :] * values[None, :, :1]
    expected, _ = signal.sosfilt(sections, values, zi=begin)
    # the direct form loses digits to poles near 1: some five of sixteen for two of them, nine for four
    lost = 1e-10 if order <= 2 else 1e-7
    np.testing.assert_allclose(LowPassFilter(settings, RATE_HZ)(values), expected, rtol=0, atol=lost)


@given(st.integers(0, 1000), CUTS)
def test_how_samples_are_cut_into_blocks_changes_no_bit(seed: int, cuts: list[int]) -> None:
    values, low_pass = walk(seed), LowPassFilter(ConditioningSettings(), RATE_HZ)
    edges = sorted({0, 300, *cuts})
    in_blocks = np.concatenate([low_pass(values[:, begin:end]) for begin, end in pairwise(edges)], axis=1)
    np.testing.assert_array_equal(in_blocks, LowPassFilter(ConditioningSettings(), RATE_HZ)(values))


@given(st.floats(-10, 10), st.floats(-200, 200))
def test_it_begins_steady_at_whatever_comes_first(strain_v: float, encoder_deg: float) -> None:
    values = np.repeat([[strain_v], [encoder_deg]], 500, axis=1)
    np.testing.assert_allclose(LowPassFilter(ConditioningSettings(), RATE_HZ)(values), values, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    ("frequency_hz", "gain"),
    [(10.0, 1 / math.sqrt(2)), (1.0, 1 / math.sqrt(1 + 0.1**4)), (40.0, 1 / math.sqrt(1 + 4.0**4))],
)
def test_it_halves_the_power_at_10_hz_and_falls_by_the_square_beyond(frequency_hz: float, gain: float) -> None:
    time_s = np.arange(4000) / RATE_HZ
    filtered = LowPassFilter(ConditioningSettings(), RATE_HZ)(np.sin(2 * np.pi * frequency_hz * time_s)[None])[0]
    # |H| = 1 / sqrt(1 + (f / fc)^4) of the analog filter; the bilinear transform bends 40 Hz by 1 % of frequency
    assert math.sqrt(2 * np.mean(filtered[2000:] ** 2)) == pytest.approx(gain, rel=0.015)


def test_what_people_look_at_is_22_ms_late() -> None:
    ramp = np.arange(2000.0)[None]
    delay_ms = (ramp - LowPassFilter(ConditioningSettings(), RATE_HZ)(ramp))[0, -1]
    # the group delay of a 2nd-order Butterworth filter at rest is sqrt(2) / (2 pi fc)
    assert delay_ms == pytest.approx(1e3 * math.sqrt(2) / (2 * math.pi * 10.0), rel=0.001)
