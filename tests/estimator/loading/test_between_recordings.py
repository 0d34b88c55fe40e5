"""What another recording is likely to look like."""

import numpy as np
import pytest

from estimator.loading.between_recordings import RecordingCenters, between_covariance, estimate_session_scale
from estimator.loading.constants import BETWEEN_SD, SESSION_SCALE

SLOW, FAST = np.log(2.0), np.log(32.0)
F = len(BETWEEN_SD)


def recorded(*rows):
    """Rows of (tissue, ramp_log, level): centres with that level in every feature, in units of BETWEEN_SD."""
    tissue, ramp, level = zip(*rows, strict=True)
    return RecordingCenters(np.array(tissue), np.array(ramp), np.outer(level, BETWEEN_SD), SESSION_SCALE)


def test_what_all_differences_share_is_a_covariance():
    np.linalg.cholesky(between_covariance())
    assert np.sqrt(np.diag(between_covariance())) == pytest.approx(BETWEEN_SD)


def test_at_a_known_ramp_it_is_the_recording_give_or_take_two_sessions():
    centre, variance = recorded((0, SLOW, 0.0), (1, SLOW, 5.0)).predict_center(1, SLOW)
    assert centre / BETWEEN_SD == pytest.approx(np.full(F, 5.0), abs=0.05)
    assert variance == pytest.approx(2 * SESSION_SCALE**2, rel=0.2)


def test_another_ramp_is_less_certain():
    known = recorded((0, SLOW, 0.0), (1, SLOW, 5.0))
    assert known.predict_center(1, FAST)[1] > 10 * known.predict_center(1, SLOW)[1]


def test_what_a_ramp_changes_is_learned_from_the_other_tissues():
    both = recorded((0, SLOW, 0.0), (0, FAST, 3.0), (1, SLOW, 5.0), (1, FAST, 8.0), (2, SLOW, -4.0))
    alone = recorded((0, SLOW, 0.0), (1, SLOW, 5.0), (2, SLOW, -4.0))
    centre, variance = both.predict_center(2, FAST)
    assert centre / BETWEEN_SD == pytest.approx(np.full(F, -1.0), abs=0.3)
    assert variance < alone.predict_center(2, FAST)[1] / 4


def test_recordings_that_repeat_each_other_narrow_the_sessions_and_others_widen_them():
    tissue, ramp = np.array([0, 0, 1, 1]), np.full(4, SLOW)
    narrow = estimate_session_scale(tissue, ramp, np.outer([0.0, 0.01, 5.0, 5.01], BETWEEN_SD))
    wide = estimate_session_scale(tissue, ramp, np.outer([0.0, 4.0, 5.0, 9.0], BETWEEN_SD))
    assert narrow < SESSION_SCALE < wide
    assert estimate_session_scale(np.array([0, 1]), ramp[:2], np.zeros((2, F))) == SESSION_SCALE
