"""Eqs. (1) to (6), against the paper written out for one sample and against what a linkage must do."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.signals.calibration import JawSignals, compute_jaw_signals, compute_sensor_signals_from_jaws
from config.load import load_tool
from config.schema import ForceScale

TOOL = load_tool("simulated")
COUNT_DEG = 360 / (500 * 4 * 19)
FORCES_N = st.floats(0.0, 6.0)  # up to the tool's ceiling
DISPLACEMENTS_M = st.floats(0.0, 0.012)  # beyond what any tissue of the library gives way at 2 N
VOLTS = st.floats(-1.0, 3.0)
DEGREES = st.floats(-30.0, 300.0)
SIGNALS = ("force_n", "displacement_m", "angle_rad", "newton_per_volt", "metre_per_volt")


def jaw(strain_v: float, encoder_deg: float) -> JawSignals:
    return compute_jaw_signals(TOOL, np.array([strain_v]), np.array([encoder_deg]))


def exact(scale: float) -> ForceScale:
    return ForceScale(value=scale, low=scale, high=scale, measured=False, source="a test")


def as_in_the_paper(strain_v: float, encoder_deg: float) -> tuple[float, float, float]:
    """Jaw force (N), displacement (m) and angle (rad) from Table I and Eqs. (1) to (6); raises outside the domain."""
    r_pp, a, l0, l1, l2, l_jaw, beta0 = 73.15e-3, 10.1e-3, 9.93e-3, 4.9e-3, 5.7e-3, 27.88e-3, math.radians(18.939)
    f_handle = 11.89 * strain_v  # (1)
    theta_enc = encoder_deg - 52.189 * strain_v  # (3), (4)
    theta_handle = math.radians(18 / 188 * theta_enc)  # (5)
    p = a * math.tan(theta_handle)
    theta_jaw = math.acos((2 * l2 * l0 * math.cos(beta0) + p**2 - 2 * l0 * p) / (2 * l2 * (l0 - p))) - beta0  # (6)
    inner = math.asin(l2 / l1 * math.sin(beta0 + theta_jaw))
    bracket = math.tan(inner) * math.cos(inner) + math.sin(beta0 + theta_jaw)
    return (
        l2 * r_pp * f_handle / (2 * l_jaw * a) * bracket * math.cos(theta_jaw),  # (2)
        l_jaw * math.sin(theta_jaw),
        theta_jaw,
    )


@given(VOLTS, DEGREES)
def test_force_and_displacement_are_the_papers(strain_v: float, encoder_deg: float) -> None:
    signals = jaw(strain_v, encoder_deg)
    try:
        force_n, displacement_m, angle_rad = as_in_the_paper(strain_v, encoder_deg)
    except ValueError:  # outside the domain of arccos or arcsin
        assert not signals.valid[0]
        return
    if not signals.valid[0]:  # only exactly at a bound, where the two may round to either side
        assert abs(math.sin(angle_rad + math.radians(18.939))) < 1e-6
        return
    # a displacement near zero is a difference of angles near beta0: rounding of cos(beta0) leaves 1e-17 m
    assert signals.displacement_m[0] == pytest.approx(displacement_m, rel=1e-9, abs=1e-14)
    assert signals.force_n[0] == pytest.approx(force_n, rel=1e-9, abs=1e-14)
    assert signals.angle_rad[0] == pytest.approx(angle_rad, rel=1e-9, abs=1e-12)


@given(FORCES_N, DISPLACEMENTS_M)
def test_going_back_to_the_sensors_and_forth_gives_the_same_force_and_displacement(
    force_n: float, displacement_m: float
) -> None:
    signals = jaw(*compute_sensor_signals_from_jaws(TOOL, force_n, displacement_m))
    assert signals.valid[0]
    assert signals.force_n[0] == pytest.approx(force_n, rel=1e-11, abs=1e-12)
    assert signals.displacement_m[0] == pytest.approx(displacement_m, rel=1e-9, abs=1e-14)


@given(st.floats(0.0, 2.0), st.floats(-2.0, 25.0))
def test_going_forth_and_back_gives_the_same_volts_and_degrees(strain_v: float, handle_deg: float) -> None:
    encoder_deg = handle_deg * 188 / 18 + 52.189 * strain_v
    signals = jaw(strain_v, encoder_deg)
    back_v, back_deg = compute_sensor_signals_from_jaws(
        TOOL, float(signals.force_n[0]), float(signals.displacement_m[0])
    )
    assert back_v == pytest.approx(strain_v, rel=1e-11, abs=1e-12)
    assert back_deg == pytest.approx(encoder_deg, abs=1e-8)  # a millionth of an encoder count


@given(DEGREES, st.floats(0.1, 10.0))
def test_an_unresolved_newton_scale_multiplies_force_and_leaves_displacement(encoder_deg: float, scale: float) -> None:
    calibration = TOOL.calibration.model_copy(update={"jaw_force_scale": exact(scale)})
    scaled = compute_jaw_signals(
        TOOL.model_copy(update={"calibration": calibration}), np.array([0.5]), np.array([encoder_deg])
    )
    plain = jaw(0.5, encoder_deg)
    np.testing.assert_allclose(scaled.force_n, scale * plain.force_n, rtol=1e-12)
    np.testing.assert_allclose(scaled.newton_per_volt, scale * plain.newton_per_volt, rtol=1e-12)
    np.testing.assert_array_equal(scaled.displacement_m, plain.displacement_m)


@given(VOLTS, DEGREES)
def test_the_coupling_link_keeps_its_length_at_every_angle(strain_v: float, encoder_deg: float) -> None:
    """The slider at L0 - p, the crank L2 and the angle between them enclose the coupling link L1 (law of cosines)."""
    geometry, signals = TOOL.geometry, jaw(strain_v, encoder_deg)
    if not signals.valid[0]:
        return
    slider_m = geometry.l0_m - geometry.a_m * math.tan(math.radians(18 / 188 * (encoder_deg - 52.189 * strain_v)))
    angle = float(signals.angle_rad[0]) + math.radians(geometry.beta0_deg)
    link_m = math.sqrt(slider_m**2 + geometry.l2_m**2 - 2 * slider_m * geometry.l2_m * math.cos(angle))
    # Table I gives its lengths to 0.05 mm at best and beta0 of its own: they close to 1 µm at rest
    assert link_m == pytest.approx(geometry.l1_m, abs=2e-6)


@given(st.floats(-0.5, 2.0), st.floats(-1.5, 25.0))
def test_sensitivities_to_strain_are_the_slopes_at_a_held_encoder(strain_v: float, handle_deg: float) -> None:
    encoder_deg, step_v = handle_deg * 188 / 18 + 52.189 * strain_v, 1e-5
    signals, above, below = (jaw(strain_v + k * step_v, encoder_deg) for k in (0, 1, -1))
    slope_n = (above.force_n[0] - below.force_n[0]) / (2 * step_v)
    slope_m = (above.displacement_m[0] - below.displacement_m[0]) / (2 * step_v)
    # a central difference over 1e-5 V is good to its square and to the rounding of the values over 2e-5 V
    assert signals.newton_per_volt[0] == pytest.approx(slope_n, rel=1e-7, abs=1e-8)
    assert signals.metre_per_volt[0] == pytest.approx(slope_m, rel=1e-7, abs=1e-10)


@given(st.floats(-12, 12), st.floats(-2000, 2000))
def test_a_sample_is_either_valid_and_finite_or_flagged_and_nan(strain_v: float, encoder_deg: float) -> None:
    signals = jaw(strain_v, encoder_deg)
    values = np.array([getattr(signals, name)[0] for name in SIGNALS])
    assert np.isfinite(values).all() if signals.valid[0] else np.isnan(values).all()


@given(st.sampled_from([math.nan, math.inf, -math.inf]), st.floats(-1, 1))
def test_a_reading_that_is_no_number_is_flagged(nothing: float, other: float) -> None:
    assert not jaw(nothing, other).valid[0]
    assert not jaw(other, nothing).valid[0]


def test_one_bad_sample_leaves_its_neighbours_alone() -> None:
    signals = compute_jaw_signals(TOOL, np.zeros(3), np.array([10.0, -500.0, 10.0]))
    assert list(signals.valid) == [True, False, True]
    assert signals.displacement_m[0] == signals.displacement_m[2] == jaw(0.0, 10.0).displacement_m[0]


@pytest.mark.parametrize(("handle_deg", "valid"), [(-3.75, True), (-3.85, False), (30.0, True), (60.0, False)])
def test_the_domain_ends_at_about_minus_3_8_degrees_of_the_handle(handle_deg: float, valid: bool) -> None:
    assert jaw(0.0, handle_deg * 188 / 18).valid[0] == valid


def test_wherever_it_is_valid_a_closing_handle_closes_the_jaws() -> None:
    encoder_deg = np.arange(-60.0, 1000.0, 0.5)
    signals = compute_jaw_signals(TOOL, np.zeros_like(encoder_deg), encoder_deg)
    assert (np.diff(signals.displacement_m[signals.valid]) > 0).all()


@pytest.mark.parametrize("displacement_m", [0.03, -0.02, 0.025, math.nan])
def test_a_displacement_out_of_reach_has_no_way_back(displacement_m: float) -> None:
    with pytest.raises(ValueError, match="displacement"):
        compute_sensor_signals_from_jaws(TOOL, 1.0, displacement_m)


def test_at_rest_one_encoder_count_is_about_a_micrometre() -> None:
    step_m = jaw(0.0, COUNT_DEG).displacement_m[0] - jaw(0.0, 0.0).displacement_m[0]
    assert round(step_m * 1e6) == 1


def test_strain_noise_of_2_mv_is_12_um_of_displacement_and_12_to_21_mn_of_force_with_opposite_signs() -> None:
    rest, closed = (
        jaw(0.0, 0.0),
        jaw(*compute_sensor_signals_from_jaws(TOOL, 0.0, 0.0081)),
    )  # free travel and the bladder's 7.6 mm at 2 N
    assert round(rest.metre_per_volt[0] * 2e-3 * 1e6) == -12
    assert round(rest.newton_per_volt[0] * 2e-3, 3) == 0.012
    assert round(closed.newton_per_volt[0] * 2e-3, 3) == 0.021
    rng = np.random.default_rng(0)
    volts, degrees = compute_sensor_signals_from_jaws(TOOL, 0.5, 0.001)
    noisy = compute_jaw_signals(TOOL, volts + 0.002 * rng.standard_normal(2000), np.full(2000, degrees))
    correlation = np.corrcoef(noisy.force_n, noisy.displacement_m)[0, 1]
    assert correlation < -0.9999  # perfect but for the curvature over 2 mV
