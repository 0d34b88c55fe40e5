"""Samples with any times, brought to the ticks of a clock while they arrive."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.drivers.tick_grid import TickGrid

RATE_HZ = 370.0


def pop_all(grid: TickGrid) -> tuple[np.ndarray, np.ndarray]:
    ticks, values = [], []
    while len(grid):
        first, rows = grid.pop_consecutive(100)
        ticks.extend(range(first, first + len(rows)))
        values.extend(rows[:, 0])
    return np.array(ticks), np.array(values)


@given(
    steps_ms=st.lists(st.integers(1, 20), min_size=2, max_size=200),
    begin_s=st.floats(0.0, 1e5),
    seed=st.integers(0, 99),
)
def test_values_are_interpolated_between_samples_that_jitter(steps_ms: list[int], begin_s: float, seed: int) -> None:
    time_s = begin_s + np.cumsum([0, *steps_ms]) * 1e-3
    values = np.random.default_rng(seed).normal(0.0, 1.0, len(time_s))
    grid = TickGrid(RATE_HZ)
    for at_s, value in zip(time_s.tolist(), values.tolist(), strict=True):
        grid.append(at_s, [value], arrival_s=at_s)
    ticks, found = pop_all(grid)
    assert ticks.tolist() == list(range(len(ticks)))
    assert abs(len(ticks) - 1 - (time_s[-1] - time_s[0]) * RATE_HZ) <= 1
    assert found == pytest.approx(np.interp(time_s[0] + ticks / RATE_HZ, time_s, values), abs=1e-5)


@given(lost_s=st.floats(0.05, 100.0), restarts=st.booleans(), count=st.integers(2, 50), again=st.integers(2, 50))
def test_a_gap_is_as_long_as_this_computers_clock_says(lost_s: float, restarts: bool, count: int, again: int) -> None:
    grid = TickGrid(1000.0)
    for i in range(count):
        grid.append(50.0 + i * 1e-3, [1.0], arrival_s=7.0 + i * 1e-3)
    after_s = 0.0 if restarts else 50.0 + (count - 1) * 1e-3 + lost_s
    for i in range(again):
        grid.append(after_s + i * 1e-3, [2.0], arrival_s=7.0 + (count - 1 + i) * 1e-3 + lost_s)
    ticks, values = pop_all(grid)
    assert values.tolist() == [1.0] * count + [2.0] * again
    assert ticks[count] - ticks[count - 1] == pytest.approx(lost_s * 1000.0, abs=2)
    assert np.diff(ticks[count:]).tolist() == [1] * (again - 1)


@given(bad_s=st.one_of(st.floats(-1e9, 1e9), st.just(50.0025)), at=st.integers(1, 8))
def test_one_damaged_time_makes_no_gap(bad_s: float, at: int) -> None:
    grid = TickGrid(1000.0)
    for i in range(10):
        is_bad = i == at and not 0 < bad_s - (50.0 + (at - 1) * 1e-3) <= 0.01
        grid.append(bad_s if is_bad else 50.0 + i * 1e-3, [float(i)], arrival_s=7.0 + i * 1e-3)
    ticks, values = pop_all(grid)
    assert ticks.tolist() == list(range(10))
    assert values == pytest.approx(np.arange(10.0), abs=1e-6)
