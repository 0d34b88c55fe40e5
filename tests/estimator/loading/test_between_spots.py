"""What another spot of a tissue, and another tissue, are likely to look like."""

import numpy as np
import pytest

from estimator.loading.between_spots import SpotCenters, correlate_features, estimate_spot_spread
from estimator.loading.constants import BETWEEN_SD, SPOT_SD

SLOW, FAST = np.log(2.0), np.log(32.0)
F = len(BETWEEN_SD)


def recorded(*rows):
    """Rows of (tissue, ramp_log, level): centers with that level in every feature, in units of BETWEEN_SD."""
    tissue, ramp, level = zip(*rows, strict=True)
    return SpotCenters(np.array(tissue), np.array(ramp), np.outer(level, BETWEEN_SD), SPOT_SD, 0)


def variances(known, tissue, ramp):
    return np.diag(known.predict_center(tissue, ramp)[1])


def test_what_all_differences_share_is_a_covariance():
    np.linalg.cholesky(correlate_features(BETWEEN_SD))
    assert np.sqrt(np.diag(correlate_features(BETWEEN_SD))) == pytest.approx(BETWEEN_SD)


def test_at_a_known_ramp_it_is_the_spot_give_or_take_two_deviations():
    known = recorded((0, SLOW, 0.0), (1, SLOW, 5.0))
    center, _ = known.predict_center(1, SLOW)
    assert center / BETWEEN_SD == pytest.approx(np.full(F, 5.0), abs=0.05)
    assert variances(known, 1, SLOW) == pytest.approx(2 * SPOT_SD**2, rel=0.2)


def test_another_ramp_is_less_certain():
    known = recorded((0, SLOW, 0.0), (1, SLOW, 5.0))
    assert (variances(known, 1, FAST) > 3 * variances(known, 1, SLOW)).all()


def test_what_a_ramp_changes_is_learned_from_the_other_tissues():
    both = recorded((0, SLOW, 0.0), (0, FAST, 3.0), (1, SLOW, 5.0), (1, FAST, 8.0), (2, SLOW, -4.0))
    alone = recorded((0, SLOW, 0.0), (1, SLOW, 5.0), (2, SLOW, -4.0))
    center, _ = both.predict_center(2, FAST)
    assert center / BETWEEN_SD == pytest.approx(np.full(F, -1.0), abs=0.6)
    assert (variances(both, 2, FAST) < variances(alone, 2, FAST) / 2).all()


def test_repeated_spots_move_the_spread_feature_by_feature():
    tissue, ramp = np.array([0, 0, 1, 1]), np.full(4, SLOW)
    off = np.where(np.arange(F) < F // 2, 0.01, 4.0) * SPOT_SD  # the first features repeat, the others do not
    spread, pairs = estimate_spot_spread(tissue, ramp, np.array([0 * off, off, 5 + 0 * off, 5 + off]))
    assert pairs == 2
    assert (spread[: F // 2] < 0.75 * SPOT_SD[: F // 2]).all()
    assert (spread[F // 2 :] > 1.5 * SPOT_SD[F // 2 :]).all()


def test_spots_of_other_tissues_or_ramps_are_no_pairs():
    for tissue, ramp in (([0, 1], [SLOW, SLOW]), ([0, 0], [SLOW, FAST])):
        spread, pairs = estimate_spot_spread(np.array(tissue), np.array(ramp), np.zeros((2, F)))
        assert pairs == 0
        assert spread == pytest.approx(SPOT_SD)


def test_a_tissue_that_was_not_learned_may_lie_between_and_beyond_the_others():
    known = recorded((0, SLOW, -10.0), (1, SLOW, 10.0))
    mean, covariance, freedom = known.predict_other_tissue(np.outer([-10.0, 10.0], BETWEEN_SD))
    assert mean == pytest.approx(np.zeros(F))
    assert (np.sqrt(np.diag(covariance)) > 10 * BETWEEN_SD / 2).all()
    assert freedom == known.degrees_of_freedom == 2  # far from all tissues it is the likeliest
