"""What the studies measure, against computations done by hand or another way."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.studies.probability_scores import calibration_error, compute_confusion_matrix, score_answers


def test_score_counts_what_it_says():
    p = np.array([[0.96, 0.02, 0.02], [0.97, 0.02, 0.01], [0.2, 0.7, 0.1], [0.5, 0.3, 0.2]])
    found = score_answers(p, np.array([0, 1, 1, 1]))
    assert found.accuracy == 0.5
    assert found.confident == 0.5
    assert found.confident_wrong == 0.25
    assert found.log_loss == pytest.approx(-np.mean(np.log([0.96, 0.02, 0.7, 0.3])))


def test_calibration_error_of_a_forecaster_who_is_always_too_sure():
    confidence = np.full(1000, 0.95)
    assert calibration_error(confidence, np.arange(1000) % 10 < 7) == pytest.approx(0.25)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_calibration_error_of_an_honest_forecaster_is_near_zero(seed):
    rng = np.random.default_rng(seed)
    confidence = rng.uniform(0.3, 1.0, 20_000)
    right = rng.uniform(size=20_000) < confidence
    # each of up to 8 bins is off by at most 0.5 / sqrt(2,500) on average; five times that is not met by chance
    assert calibration_error(confidence, right) < 0.05


def test_confusion_is_a_share_of_each_truth():
    p = np.eye(3)[[0, 1, 1, 2]]
    table = compute_confusion_matrix(p, np.array([0, 0, 1, 1]), 3)
    assert table.tolist() == [[0.5, 0.5, 0.0], [0.0, 0.5, 0.5]]
