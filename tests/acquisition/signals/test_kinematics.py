"""Kinematics of other tools: the inverse, slopes against finite differences, and a simulated grasp of each."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulation import simulate_raw

from acquisition.bench.fits import check_has_linkage
from acquisition.safety.force_limiter import find_stop_reason
from acquisition.sample_block import SAMPLE_DTYPE, SampleFlag
from acquisition.signals.calibration import compute_jaw_signals, compute_sensor_signals_from_jaws
from acquisition.signals.pipeline import ConditioningPipeline
from config.errors import CalibrationError, ConfigurationError
from config.load import load_settings, load_tool
from config.schema import Tool

SIMULATED = load_tool("simulated")
DIRECT = {"kind": "direct", "newton_per_volt": 1.7, "metre_per_degree": 6e-5, "stretch_deg_per_volt": 3.0}
LEVER = {
    "kind": "lever",
    "newton_per_volt": 4.0,
    "handle_arm_m": 0.02,
    "jaw_arm_m": 0.03,
    "jaw_per_handle": 0.1,
    "stretch_deg_per_volt": 5.0,
}
TABLE = {
    "kind": "table",
    "strain_v": [-1.0, 0.0, 1.0, 2.0, 5.0],
    "force_n": [-1.0, 0.0, 1.5, 4.0, 6.5],
    "encoder_deg": [-20.0, 0.0, 60.0, 150.0, 300.0],
    "displacement_m": [-0.001, 0.0, 0.004, 0.008, 0.02],
}
KINEMATICS = [DIRECT, LEVER, TABLE]
CONSTANTS = ("newton_per_volt", "encoder_deg_per_volt", "handle_per_encoder")


def tool_with(kinematics: dict, **calibration: object) -> Tool:
    """The simulated tool with other kinematics, as from a tool file."""
    content = json.loads(SIMULATED.model_dump_json())
    content["geometry"] = None
    content["kinematics"] = {**kinematics, "opening_m": 0.01}
    content["calibration"] = {k: v for k, v in content["calibration"].items() if k not in CONSTANTS} | calibration
    return Tool.model_validate_json(json.dumps(content))


@pytest.mark.parametrize("kinematics", KINEMATICS, ids=lambda each: each["kind"])
@given(force_n=st.floats(-0.9, 6.0), displacement_m=st.floats(-0.0009, 0.012))
def test_force_and_displacement_come_back_through_the_sensors(kinematics, force_n, displacement_m):
    tool = tool_with(kinematics)
    strain_v, encoder_deg = compute_sensor_signals_from_jaws(tool, force_n, displacement_m)
    jaw = compute_jaw_signals(tool, np.array([strain_v]), np.array([encoder_deg]))
    assert jaw.valid[0]
    assert jaw.force_n[0] == pytest.approx(force_n, abs=1e-9)
    assert jaw.displacement_m[0] == pytest.approx(displacement_m, abs=1e-12)


@pytest.mark.parametrize("kinematics", KINEMATICS, ids=lambda each: each["kind"])
@given(strain_v=st.floats(-0.9, 4.9), encoder_deg=st.floats(0.0, 250.0))
def test_slopes_are_those_of_finite_differences_and_both_maps_are_monotone(kinematics, strain_v, encoder_deg):
    tool, step = tool_with(kinematics), 1e-6
    volts = np.array([strain_v - step, strain_v, strain_v + step])
    jaw = compute_jaw_signals(tool, volts, np.full(3, encoder_deg))
    assert jaw.newton_per_volt[1] == pytest.approx((jaw.force_n[2] - jaw.force_n[0]) / (2 * step), rel=1e-4, abs=1e-4)
    by_volt = (jaw.displacement_m[2] - jaw.displacement_m[0]) / (2 * step)
    assert jaw.metre_per_volt[1] == pytest.approx(by_volt, rel=1e-4, abs=1e-7)
    degrees = encoder_deg + np.array([0.0, 0.5, 1.0])
    assert (np.diff(compute_jaw_signals(tool, np.full(3, strain_v), degrees).displacement_m) > 0).all()


def test_a_reading_beyond_the_table_is_invalid_and_not_clipped():
    jaw = compute_jaw_signals(tool_with(TABLE), np.array([1.0, 5.1, 1.0]), np.array([10.0, 10.0, 301.0]))
    assert jaw.valid.tolist() == [True, False, False]
    assert np.isnan(jaw.force_n[1])
    assert jaw.force_n[2] == 1.5, "it does not depend on the position"


def test_a_lever_does_as_much_work_at_the_jaws_as_at_the_handle():
    tool = tool_with({**LEVER, "stretch_deg_per_volt": 0.0})
    degrees = np.linspace(0.0, 600.0, 601)  # of the handle; the jaws turn by 60
    jaw = compute_jaw_signals(tool, np.full(601, 2.0), degrees)
    at_handle_j = 2.0 * 4.0 * 0.02 * np.radians(600.0)
    assert float(np.trapezoid(jaw.force_n, jaw.displacement_m)) == pytest.approx(at_handle_j, rel=1e-9)


@pytest.mark.parametrize("kinematics", KINEMATICS, ids=lambda each: each["kind"])
def test_it_can_be_simulated_and_the_pipeline_finds_the_grasp_and_its_force(kinematics):
    tool = tool_with(kinematics)
    pipeline = ConditioningPipeline(tool, load_settings(None).conditioning)
    blocks = [pipeline.process(raw).samples for raw in simulate_raw("liver", tool=tool)]
    samples = np.concatenate(blocks)
    assert samples["grasp"].max() == 1
    assert float(np.nanmax(samples["jaw_force_filtered_n"])) == pytest.approx(1.55, abs=0.1)
    assert (samples["contact_tick"] >= 0).any()


@pytest.mark.parametrize(
    ("kinematics", "calibration", "expected"),
    [
        ({**TABLE, "force_n": [-1.0, 0.0, 1.5, 1.0, 6.5]}, {}, "must rise from value to value"),
        ({**TABLE, "force_n": [-1.0, 0.1, 1.5, 4.0, 6.5]}, {}, "need the pair 0, 0"),
        ({**TABLE, "force_n": [-1.0, 0.0, 1.5, 4.0, 5.0]}, {}, "force_n must reach the force ceiling"),
        ({**TABLE, "displacement_m": [-0.001, 0.0, 0.004, 0.008, 0.009]}, {}, "displacement_m must reach opening_m"),
        ({**TABLE, "strain_v": [0.0, 0.0, 1.0, 2.0, 5.0]}, {}, "must rise from value to value"),
        ({**TABLE, "displacement_m": [-0.1, 0.0, 0.1]}, {}, "same number of values"),
        ({**DIRECT, "newton_per_volt": -1.0}, {}, "greater than 0"),
        (DIRECT, {"newton_per_volt": 11.89}, "belong to the kinematics `smart_tool`"),
        ({"kind": "belt"}, {}, "belt"),
    ],
)
def test_kinematics_that_cannot_be_are_refused_by_name(kinematics, calibration, expected):
    with pytest.raises((ValueError, ConfigurationError), match=expected):
        tool_with(kinematics, **calibration)


def test_the_smart_tool_needs_its_constants_and_a_recording_keeps_other_kinematics():
    content = json.loads(SIMULATED.model_dump_json())
    assert "kinematics" not in content
    del content["calibration"]["handle_per_encoder"]
    with pytest.raises(ValueError, match="calibration lacks handle_per_encoder"):
        Tool.model_validate_json(json.dumps(content))
    tool = tool_with(TABLE)
    assert Tool.model_validate_json(tool.model_dump_json()) == tool
    assert tool.calibration_fingerprint not in (
        SIMULATED.calibration_fingerprint,
        tool_with(LEVER).calibration_fingerprint,
    )


def test_a_tool_with_a_motor_finds_grasps_by_its_command_alone():
    content = json.loads(SIMULATED.model_dump_json()) | {"hand_driven": {"closing_deg": 2.0}}
    with pytest.raises(ValueError, match="is for tools without a motor"):
        Tool.model_validate_json(json.dumps(content))


@pytest.mark.parametrize("kinematics", KINEMATICS, ids=lambda each: each["kind"])
def test_a_force_over_the_ceiling_stops_the_motor_of_any_tool(kinematics):
    tool = tool_with(kinematics)
    strain_v, encoder_deg = compute_sensor_signals_from_jaws(tool, tool.limits.force_ceiling_n + 0.05, 0.004)
    samples = np.zeros(5, SAMPLE_DTYPE)
    for far_deg in (0.0, 36_000.0):  # also where the position is beyond its table
        jaw = compute_jaw_signals(tool, np.full(5, strain_v), np.full(5, encoder_deg + far_deg))
        samples["jaw_force_n"], samples["flags"] = jaw.force_n, np.where(jaw.valid, 0, SampleFlag.INVALID)
        assert "over the ceiling" in find_stop_reason(tool, samples)


def test_constants_that_belong_to_the_smart_tool_are_not_told_of_others():
    names = {origin.constant for origin in tool_with(DIRECT).constant_origins}
    assert not names & {*CONSTANTS}
    with pytest.raises(CalibrationError, match="is for the kinematics `smart_tool`"):
        check_has_linkage(tool_with(DIRECT), "stretch")
