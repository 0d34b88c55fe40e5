"""Centres and covariances that outliers do not move."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.loading.robust_covariance import robust_scatter, shrunk_scatter

FLOOR = np.full(3, 1e-3)


def cloud(seed, n=30, centre=0.0):
    return centre + np.random.default_rng(seed).normal(size=(n, 3)) * [1.0, 0.5, 0.1]


@given(
    sizes=st.lists(st.integers(1, 12), min_size=1, max_size=4),
    seed=st.integers(0, 10_000),
    scale=st.sampled_from([0, 1e-9, 1, 1e6]),
)
def test_covariances_are_positive_definite_whatever_the_grasps(sizes, seed, scale):
    groups = [scale * cloud(seed + i, n) for i, n in enumerate(sizes)]
    centres, weights, pooled = robust_scatter(groups, FLOOR)
    for cov in (
        pooled,
        *(shrunk_scatter([g], [c], [w], pooled) for g, c, w in zip(groups, centres, weights, strict=True)),
    ):
        np.linalg.cholesky(cov)
        assert np.allclose(cov, cov.T)


def test_outlying_grasps_hardly_move_centre_or_covariance():
    clean = cloud(1, 20)
    spoilt = clean.copy()
    spoilt[:3] = 50.0
    (sound,), _, cov = robust_scatter([clean], FLOOR)
    (moved,), _, cov_spoilt = robust_scatter([spoilt], FLOOR)
    assert moved == pytest.approx(sound, abs=0.6)
    assert np.trace(cov_spoilt) < 4 * np.trace(cov)
    assert np.abs(spoilt.mean(axis=0) - sound).max() > 7  # as the mean would be


def test_without_outliers_it_is_the_mean_and_about_the_covariance():
    (centre,), _, cov = robust_scatter([cloud(2, 4000, 7.0)], FLOOR)
    assert centre == pytest.approx([7.0] * 3, abs=0.05)
    assert np.sqrt(np.diag(cov)) == pytest.approx([1.0, 0.5, 0.1], rel=0.3)


def test_the_order_of_groups_does_not_matter():
    groups = [cloud(i, 10, i) for i in range(3)]
    centres, _, pooled = robust_scatter(groups, FLOOR)
    turned, _, again = robust_scatter(groups[::-1], FLOOR)
    assert pooled == pytest.approx(again)
    assert centres[0] == pytest.approx(turned[2])
