"""What a loading curve tells, and that it does not matter how its samples come."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from learned import pressed

from estimator.loading.constants import BETWEEN_SD, FEATURES, FORCE_GAPS_DEG
from estimator.loading.loading_curve import FORCES, KNEE, LEAN, OPENING, STALL, LoadingCurve

STRETCH, PEAK_V, DT_S = 52.189, 2.5, 1e-3
AT_REST_DEG = -STRETCH * 0.82  # what the gage's rest voltage takes off the encoder


def followed(samples, size=500, shut_before_deg=None, first=False):
    loading = LoadingCurve(STRETCH, PEAK_V, DT_S, shut_before_deg, first=first)
    for begin in range(0, len(samples), size):
        loading.append(samples[begin : begin + size])
    return loading


def test_it_measures_the_grasp_that_was_made():
    loading = followed(pressed(0.3, gap_deg=120.0, offset_deg=-700.0))
    seen = loading.observe_features()
    assert loading.ended
    assert loading.jaw_closure_deg == pytest.approx(-580.0 + AT_REST_DEG, abs=0.5)
    assert seen.features[OPENING] == pytest.approx(10.0, abs=0.1)  # in units of 12 deg
    assert np.sinh(seen.features[LEAN]) * 2 == pytest.approx(0.0, abs=0.5)  # a wall gives no more than the cable
    at_5_deg = 0.3 * np.exp(5 / 15) / PEAK_V
    assert np.exp(seen.features[FORCES][1]) - 0.02 == pytest.approx(at_5_deg, rel=0.1)
    assert np.exp(seen.features[STALL]) == pytest.approx(1.0, rel=0.02)
    assert np.exp(seen.ramp_log) == pytest.approx(10.0, rel=0.06)  # V/s, told in steps of 10 %


def test_stiffer_tissue_resists_sooner_and_gives_way_later():
    soft, stiff = (followed(pressed(stiffness)).observe_features().features for stiffness in (0.1, 0.5))
    assert np.all(stiff[FORCES] > soft[FORCES])
    assert stiff[KNEE] > soft[KNEE]


@given(rest_v=st.floats(0.7, 0.95), offset_deg=st.floats(-5000, 5000))
def test_neither_the_tare_nor_where_the_encoder_stands_matters(rest_v, offset_deg):
    expected = followed(pressed(0.2)).observe_features().features
    found = followed(pressed(0.2, rest_v=rest_v, offset_deg=offset_deg)).observe_features().features
    assert found == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("size", [1, 5, 7, 100])
def test_the_size_of_steps_changes_no_bit(size):
    samples = pressed(0.2, seed=3)
    assert (
        followed(samples, size).observe_features().features.tobytes()
        == followed(samples).observe_features().features.tobytes()
    )


def test_only_what_has_been_passed_is_told_and_the_opening_not_before_the_jaws_are_shut():
    samples, shut_deg = pressed(0.3), 120.0 + AT_REST_DEG
    early = followed(samples[:285], shut_before_deg=shut_deg).observe_features()
    assert np.isfinite(early.features[FORCES][0])
    assert np.isnan(early.features[[OPENING, STALL, LEAN]]).all()
    assert early.closure_sensitivity[FORCES][0] > 0  # some doubt about where the jaws are shut
    assert np.isnan(followed(samples[:285]).observe_features().features[FORCES]).all()  # nothing tells where
    late = followed(samples, shut_before_deg=shut_deg).observe_features()
    assert np.isfinite(late.features).all()
    assert not late.closure_sensitivity.any()


def test_the_opening_of_a_first_grasp_says_nothing():
    assert np.isnan(followed(pressed(0.3), first=True).observe_features().features[OPENING])


def test_samples_after_the_drive_has_stalled_change_nothing():
    samples = pressed(0.3)
    again = np.concatenate([samples, pressed(2.0)])
    assert (
        followed(again).observe_features().features.tobytes() == followed(samples).observe_features().features.tobytes()
    )


def test_a_grasp_without_force_or_without_readings_tells_nothing():
    samples = pressed(0.3)
    assert np.isnan(followed(samples[:5]).observe_features().features).all()
    samples["strain_v"] = np.nan
    assert np.isnan(followed(samples).observe_features().features).all()
    assert followed(samples[:0]).observe_features().features.shape == (len(FEATURES),)


def test_names_and_spreads_belong_to_the_features():
    assert FEATURES[FORCES] == tuple(f"force_{gap:g}deg" for gap in FORCE_GAPS_DEG)
    assert (FEATURES[OPENING], FEATURES[KNEE], FEATURES[LEAN], FEATURES[STALL]) == ("opening", "knee", "lean", "stall")
    assert len(BETWEEN_SD) == len(FEATURES)
