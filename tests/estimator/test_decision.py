import numpy as np
import pytest

from config.schema import IdentificationSettings, WarningSettings
from estimator.criteria import ForceErrors
from estimator.decision import UNDECIDED, Decision
from estimator.force_alarms import ForceAlarmMonitor, Priority

NAMES = ("liver", "bladder", "unknown")


def test_names_at_the_bound_keeps_the_name_and_withdraws_it_below():
    decision = Decision(NAMES, IdentificationSettings(decide_at=0.8, withdraw_below=0.6, confirm_s=0), rate_hz=1000)
    course = [
        ([0.7, 0.2, 0.1], UNDECIDED),
        ([0.85, 0.1, 0.05], "liver"),
        ([0.65, 0.3, 0.05], "liver"),
        ([0.55, 0.4, 0.05], UNDECIDED),
        ([0.1, 0.85, 0.05], "bladder"),
    ]
    for tick, (probabilities, label) in enumerate(course):
        decision.update(np.array(probabilities), tick)
        assert decision.label == label
    assert decision.decided_tick == 4


def test_a_probability_that_only_flares_up_names_nothing():
    decision = Decision(NAMES, IdentificationSettings(decide_at=0.8, withdraw_below=0.6, confirm_s=0.03), rate_hz=1000)
    for tick in range(0, 200, 5):
        flare = 0.9 if tick % 40 < 30 else 0.7  # never 30 ms in a row
        decision.update(np.array([flare, 1 - flare, 0.0]), tick)
        assert decision.label == UNDECIDED
    for tick in range(200, 240, 5):
        decision.update(np.array([0.9, 0.1, 0.0]), tick)
    assert (decision.label, decision.decided_tick) == ("liver", 230)


def test_unknown_is_an_answer_of_equal_rank():
    decision = Decision(NAMES, IdentificationSettings(confirm_s=0), rate_hz=1000)
    decision.update(np.array([0.02, 0.03, 0.95]), 7)
    assert (decision.label, decision.decided_tick) == ("unknown", 7)


def test_convergence_is_the_latest_moment_after_which_the_error_stays_inside():
    """The bound is 15 % of the largest force: 0.3 N of 2 N."""
    force = np.array([0.5, 1.0, 2.0, 2.0, 2.0])
    errors = np.array([[0.4, 0.0, 0.1], [0.1, 0.0, 0.1], [-0.4, 0.0, 0.1], [0.2, 0.0, 0.1], [0.1, 0.0, 0.5]])
    criteria = ForceErrors(3, 0.15)
    criteria.append(force[:2, None] + errors[:2], force[:2])
    criteria.append(force[2:, None] + errors[2:], force[2:])
    assert criteria.convergence_samples() == pytest.approx([3, 0, np.nan], nan_ok=True)
    assert criteria.mean_error_n() == pytest.approx([0.08, 0.0, 0.18])


def test_a_filter_without_estimates_has_neither_convergence_nor_error():
    criteria = ForceErrors(2, 0.15)
    criteria.append(np.array([[1.0, np.nan], [1.0, np.nan]]), np.ones(2))
    assert criteria.convergence_samples() == pytest.approx([0, np.nan], nan_ok=True)
    assert criteria.mean_error_n() == pytest.approx([0.0, np.nan], nan_ok=True)


def test_warnings_rise_at_70_90_100_percent_and_fall_with_hysteresis():
    warnings = ForceAlarmMonitor(WarningSettings())
    changes = []
    for tick, force in enumerate([0.5, 0.71, 0.69, 0.64, 0.95, 1.02, 0.97, 0.92, 0.5]):
        change = warnings.update(tick, force, 1.0, None)
        if change:
            changes.append((tick, change.priority))
    assert changes == [
        (1, Priority.LOW),
        (3, None),
        (4, Priority.MEDIUM),
        (5, Priority.HIGH),
        (7, Priority.MEDIUM),
        (8, None),
    ]


def test_a_warning_follows_the_threshold_of_the_tissue_named():
    warnings = ForceAlarmMonitor(WarningSettings())
    assert warnings.update(0, 2.1, 2.25, None).priority is Priority.MEDIUM
    assert warnings.update(1, 2.1, 5.63, "small_bowel").priority is None
