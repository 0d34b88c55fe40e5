"""Grouping, Tables VI and VII and Tukey's test, against numbers worked by hand and SciPy."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reports import observed, record
from scipy.stats import f_oneway, studentized_range, tukey_hsd

from app.analysis.report.statistics import TruthSource, ValueSummary, compute_statistics, run_tukey_test

TISSUES = ("liver", "bladder")


def test_a_grasp_belongs_to_what_was_told_and_else_to_its_verdict():
    told = observed(record(label="bladder"), truth="liver", told=TruthSource.LABEL)
    assert (told.group, told.filter_tissue) == ("liver", "liver")
    assert observed(record(label="bladder")).group == "bladder"


def test_the_criteria_of_a_group_outside_the_library_are_of_the_likeliest_tissue():
    stranger = observed(record(label="unknown", probabilities={"liver": 0.1, "bladder": 0.2, "unknown": 0.7}))
    assert (stranger.group, stranger.filter_tissue) == ("unknown", "bladder")


def test_table_6_is_max_mean_and_min_of_those_that_converge():
    grasps = [
        observed(record(convergence_s=0.1, force_error_n=0.2), errors=(-0.5, 0.3)),
        observed(record(convergence_s=0.4, force_error_n=-0.1), errors=(-0.2, 0.9)),
        observed(record(convergence_s=None, force_error_n=0.5), errors=None),
    ]
    row = compute_statistics(grasps, TISSUES).convergence["liver"]
    assert row.grasps == 3
    assert row.convergence_s == ValueSummary(0.4, pytest.approx(0.25), 0.1, 2)
    assert row.error_n == ValueSummary(0.5, pytest.approx(0.2), -0.1, 3)
    assert row.sample_error_n == ValueSummary(0.9, pytest.approx(0.2), -0.5, 2)


def test_a_filter_that_diverged_has_no_force_error():
    grasps = [
        observed(record(peak_force_n=1.5, force_error_n=0.1), errors=(-0.2, 149.0)),
        observed(record(peak_force_n=1.5, force_error_n=0.3), errors=(-0.2, 151.0)),
        observed(record(peak_force_n=1.5, force_error_n=-151.0), errors=None),
    ]
    assert [one.diverged for one in grasps] == [False, True, True]
    row = compute_statistics(grasps, TISSUES).convergence["liver"]
    assert (row.error_n.count, row.error_n.mean, row.sample_error_n.largest) == (1, 0.1, 149.0)


def test_table_7_has_both_means_and_the_scatter_of_the_logarithm():
    found = compute_statistics([observed(record(alpha_n=1.0)), observed(record(alpha_n=4.0))], TISSUES)
    alpha = found.parameters["liver"]["alpha"]
    assert (alpha.mean, alpha.geometric_mean) == (pytest.approx(2.5), pytest.approx(2.0))
    assert alpha.log_sd == pytest.approx(math.log(4) / math.sqrt(2))
    assert compute_statistics([observed(record())], TISSUES).parameters["liver"]["alpha"].log_sd is None


def test_the_groups_come_in_the_library_s_order_then_others_then_unknown():
    names = ["unknown", "ureter", "bladder", "liver"]
    found = compute_statistics([observed(record(), truth=name, told=TruthSource.LABEL) for name in names], TISSUES)
    assert [*found.groups] == ["liver", "bladder", "ureter", "unknown"]


@pytest.mark.parametrize(
    ("grasp", "why"),
    [
        (record(valid=False, why_invalid="encoder slips or walks"), "invalid: encoder slips or walks"),
        (record(alpha_n=None), "no filter had an estimate"),
        (record(label="undecided"), "no tissue was named"),
    ],
)
def test_what_is_left_out_is_named_with_its_reason(grasp, why):
    found = compute_statistics([observed(record(), source="a.lvm"), observed(grasp, source="b.lvm")], TISSUES)
    assert [(one.source, why in reason) for one, reason in found.excluded] == [("b.lvm", True)]
    assert len(found.groups["liver"]) == 1


def test_an_undecided_grasp_whose_tissue_is_told_counts():
    found = compute_statistics(
        [observed(record(label="undecided"), truth="liver", told=TruthSource.RECORDING)], TISSUES
    )
    assert not found.excluded
    assert found.truth_sources == (TruthSource.RECORDING,)


def test_tukey_by_hand_for_two_groups_is_a_t_test():
    one, other = np.log([1.0, 2.0, 4.0]), np.log([3.0, 6.0, 12.0])
    found = run_tukey_test({"liver": one, "bladder": other}).pairs["liver", "bladder"]
    assert found.ratio == pytest.approx(1 / 3)
    assert found.p == pytest.approx(f_oneway(one, other).pvalue, rel=1e-3)
    # half the interval: q(0.95; 2, 4) times the SD (log 2 in both groups) by the square root of three
    half = studentized_range.ppf(0.95, 2, 4) * math.log(2) / math.sqrt(3)
    assert found.low == pytest.approx(math.exp(-math.log(3) - half), rel=1e-3)
    assert found.high == pytest.approx(math.exp(-math.log(3) + half), rel=1e-3)
    assert not found.differs


GROUPS = st.lists(
    st.lists(st.floats(-3, 3), min_size=2, max_size=6).filter(lambda values: np.ptp(values) > 0.01),
    min_size=2,
    max_size=4,
)


@settings(max_examples=12)  # the distribution takes its time
@given(GROUPS)
def test_tukey_is_scipy_s_and_does_not_depend_on_the_order_of_a_pair(groups):
    logs = {str(k): np.array(values) for k, values in enumerate(groups)}
    found, expected = run_tukey_test(logs), tukey_hsd(*logs.values())
    backwards = run_tukey_test(dict(reversed(logs.items())))
    for i, j in combinations(range(len(groups)), 2):
        pair = found.pairs[str(i), str(j)]
        assert pair.p == pytest.approx(expected.pvalue[i, j])
        assert pair.low <= pair.ratio <= pair.high
        assert pair.differs == (pair.p < 0.05)
        again = backwards.pairs[str(j), str(i)]
        assert (again.ratio, again.p) == (pytest.approx(1 / pair.ratio), pytest.approx(pair.p, abs=1e-6))


def test_groups_that_are_too_small_or_do_not_scatter_are_told_and_not_compared():
    alone = run_tukey_test({"liver": np.zeros(3), "bladder": np.zeros(1)})
    assert not alone.pairs
    assert alone.too_small_groups == ("bladder",)
    assert "two groups" in alone.skip_reason
    assert "all values are the same" in run_tukey_test({"liver": np.zeros(3), "bladder": np.ones(2)}).skip_reason
    three = run_tukey_test({"liver": np.arange(3.0), "bladder": np.arange(2.0), "ureter": np.zeros(1)})
    assert [*three.pairs] == [("liver", "bladder")]
    assert three.skip_reason is None


def test_what_tells_a_pair_apart_are_the_parameters_that_differ():
    def grasps(truth, alpha_n):
        return [
            observed(record(alpha_n=alpha_n * wobble, beta_per_m=500.0 * wobble), truth=truth, told=TruthSource.LABEL)
            for wobble in (0.9, 1.0, 1.1, 1.2)
        ]

    found = compute_statistics(grasps("liver", 1.0) + grasps("bladder", 0.01), TISSUES)
    assert found.find_distinguishing_parameters() == {("liver", "bladder"): ["alpha"]}


def test_nothing_at_all_is_no_error():
    found = compute_statistics([], TISSUES)
    assert not found.groups
    assert not found.find_distinguishing_parameters()
