"""Thinning loses no peak and packing no more than a step."""

import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from app.analysis.report.downsampling import PACKED_NAN, TimeGrid, pack_values


def unpacked(packed):
    text, low, high = packed
    steps = np.frombuffer(base64.b64decode(text), "<u2").astype(float)
    steps[steps == PACKED_NAN] = np.nan
    return low + steps * (high - low) / (PACKED_NAN - 1)


VALUES = arrays(np.float32, st.integers(1, 200), elements=st.floats(-1e3, 1e3, width=32))


@given(VALUES, st.integers(2, 60))
def test_the_least_and_the_greatest_survive_and_the_points_are_no_more_than_wanted(values, most):
    ticks = 1000 + np.arange(len(values))
    grid = TimeGrid.from_ticks(ticks, most)
    points = grid.downsample(ticks, values)
    assert len(points) == grid.point_count == len(grid.point_ticks()) <= max(most, 2)
    assert np.nanmax(points) == values.max()
    assert np.nanmin(points) == values.min()
    assert grid.point_ticks()[0] >= ticks[0]
    assert grid.point_ticks()[-1] < ticks[-1] + grid.samples_per_pair


def test_few_samples_stay_as_they_are():
    grid = TimeGrid.from_ticks(np.arange(5, 8), 10)
    assert grid.point_ticks().tolist() == [5, 6, 7]
    assert grid.downsample(np.arange(5, 8), np.array([1.0, 2.0, 3.0])).tolist() == [1, 2, 3]


def test_a_rise_stays_a_rise_and_a_fall_a_fall():
    ticks = np.arange(8)
    assert TimeGrid.from_ticks(ticks, 4).downsample(ticks, np.array([0, 1, 2, 3, 3, 2, 1, 0.0])).tolist() == [
        0,
        3,
        3,
        0,
    ]


def test_a_gap_stays_a_gap():
    ticks = np.array([0, 1, 2, 3, 40, 41, 42, 43])
    points = TimeGrid.from_ticks(ticks, 22).downsample(ticks, np.ones(8))
    assert points[[0, 1, -2, -1]].tolist() == [1, 1, 1, 1]
    assert np.isnan(points[4:-4]).all()


def test_no_samples_are_no_points():
    grid = TimeGrid.from_ticks(np.zeros(0, int), 100)
    assert grid.point_count == len(grid.downsample(np.zeros(0, int), np.zeros(0))) == 0


@given(VALUES)
def test_packing_keeps_values_to_a_step_of_their_span(values):
    values = values.astype(float)
    values[::3] = np.nan
    back = unpacked(pack_values(values))
    assert (np.isnan(back) == np.isnan(values)).all()
    span = np.nanmax(values) - np.nanmin(values) if np.isfinite(values).any() else 0.0
    assert np.nanmax(np.abs(back - values), initial=0.0) <= 0.51 * span / (PACKED_NAN - 1) + 1e-9


@pytest.mark.parametrize("values", [[np.nan, np.nan], [7.0, 7.0]])
def test_values_without_a_span_can_be_packed(values):
    assert np.array_equal(unpacked(pack_values(np.array(values))), values, equal_nan=True)
