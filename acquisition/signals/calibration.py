"""Functions between volts and degrees at the sensors and newtons and meters at the jaws, both ways.

For the Smart Tool they are Eqs. (1) to (6); [kinematics] in the tool file chooses others (`sensor_maps.py`). Outside
their domain a jaw signal is NaN and flagged invalid, never clipped.
"""

import math
from dataclasses import dataclass

import numpy as np

from acquisition.signals.sensor_maps import build_sensor_maps
from config.schema import ForceLaw, Geometry, SmartToolKinematics, Tool


@dataclass(frozen=True, slots=True)
class JawSignals:
    """Force and motion of the jaws, each array of the shape of the input.

    `angle_rad` is the turn of the Smart Tool's jaws, and NaN for other tools. `newton_per_volt` and `metre_per_volt`
    are the total derivatives of force and displacement by the strain voltage at a fixed encoder reading, cable stretch
    included. They convert the noise of the strain gage.
    """

    force_n: np.ndarray
    displacement_m: np.ndarray
    angle_rad: np.ndarray
    newton_per_volt: np.ndarray
    metre_per_volt: np.ndarray
    valid: np.ndarray


def compute_jaw_signals(tool: Tool, strain_v: np.ndarray, encoder_deg: np.ndarray) -> JawSignals:
    """Return jaw force and displacement from the tared strain voltage and the encoder angle since jaws at rest.

    Args:
        strain_v: tared strain gage voltage, V.
        encoder_deg: encoder angle after the gearbox, zero at the grasp's start, degrees.

    Source: for the Smart Tool Eqs. (1) to (6) with the geometry of Table I. By a constant force scale, Eq. (2) does not
    count.
    """
    if isinstance(tool.kinematics, SmartToolKinematics):
        return _compute_by_linkage(tool, tool.linkage, strain_v, encoder_deg)
    force_map, motion_map = build_sensor_maps(tool)
    stretch = tool.stretch_deg_per_volt
    force_n, newton_per_volt = force_map.evaluate(strain_v)
    displacement_m, metre_per_deg = motion_map.evaluate(encoder_deg - stretch * strain_v)
    return JawSignals(
        force_n,
        displacement_m,
        np.full_like(force_n, np.nan),
        newton_per_volt,
        -stretch * metre_per_deg,
        np.isfinite(force_n) & np.isfinite(displacement_m),  # the force is known also where the displacement is not
    )


def _compute_by_linkage(tool: Tool, geometry: Geometry, strain_v: np.ndarray, encoder_deg: np.ndarray) -> JawSignals:
    calibration = tool.calibration
    beta0 = math.radians(geometry.beta0_deg)
    radian_per_encoder = math.radians(calibration.handle_per_encoder)
    theta_handle = radian_per_encoder * (encoder_deg - calibration.encoder_deg_per_volt * strain_v)  # Eqs. (3)-(5)

    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        tangent = np.tan(theta_handle)
        rod = geometry.a_m * tangent  # p: travel of the push rod
        left = geometry.l0_m - rod
        numerator = 2 * geometry.l2_m * geometry.l0_m * math.cos(beta0) + rod**2 - 2 * geometry.l0_m * rod
        cosine = numerator / (2 * geometry.l2_m * left)
        angle = np.arccos(cosine)  # beta0 + theta_jaw; NaN outside its domain
        theta_jaw = angle - beta0
        sine, jaw_cosine = np.sin(angle), np.cos(theta_jaw)
        jaw_sine = np.sin(theta_jaw)
        crank = geometry.l2_m / geometry.l1_m * sine  # s of Eq. (2)
        rod_angle = np.arcsin(crank)
        transmission = (  # Eq. (2) as printed; tan(asin s) cos(asin s) is s, the paper writes it out
            geometry.l2_m
            * geometry.r_pp_m
            / (2 * geometry.l_jaw_m * geometry.a_m)
            * (np.tan(rod_angle) * np.cos(rod_angle) + sine)
            * jaw_cosine
        )
        scale = calibration.jaw_force_scale
        by_eq2 = scale.law is ForceLaw.EQUATION_2
        gain = transmission * calibration.newton_per_volt * scale.value if by_eq2 else np.full_like(angle, scale.value)
        force = gain * strain_v
        displacement = geometry.l_jaw_m * jaw_sine  # Eq. (6)

        cosine_by_rod = (numerator - 2 * left**2) / (2 * geometry.l2_m * left**2)
        angle_by_volt = (
            cosine_by_rod
            / sine  # the minus signs of d(arccos) and of the stretch cancel
            * geometry.a_m
            * (1 + tangent**2)
            * radian_per_encoder
            * calibration.encoder_deg_per_volt
        )
        gain_by_angle = by_eq2 * gain * (np.cos(angle) / sine - jaw_sine / jaw_cosine)
        newton_per_volt = gain + strain_v * gain_by_angle * angle_by_volt
        metre_per_volt = geometry.l_jaw_m * jaw_cosine * angle_by_volt

        valid = (
            (left > 0)
            & (np.abs(cosine) < 1)
            & (np.abs(crank) <= 1)
            & (cosine_by_rod < 0)
            & (np.abs(theta_handle) < np.pi / 2)
            & (np.abs(theta_jaw) < np.pi / 2)
        )
    if not valid.all():
        for signal in (force, displacement, theta_jaw, newton_per_volt, metre_per_volt):
            signal[~valid] = np.nan
    return JawSignals(force, displacement, theta_jaw, newton_per_volt, metre_per_volt, valid)


def compute_sensor_signals_from_jaws(tool: Tool, force_n: float, displacement_m: float) -> tuple[float, float]:
    """Return the tared strain voltage (V) and encoder angle (degrees) for a jaw force, N, and displacement, m.

    It is the inverse of `compute_jaw_signals`.

    Raises:
        ValueError: the jaws cannot reach the displacement or force; the text says which limit it exceeds.
    """
    if isinstance(tool.kinematics, SmartToolKinematics):
        return _invert_linkage(tool, tool.linkage, force_n, displacement_m)
    force_map, motion_map = build_sensor_maps(tool)
    strain_v = force_map.invert(force_n)
    return strain_v, motion_map.invert(displacement_m) + tool.stretch_deg_per_volt * strain_v


def _invert_linkage(tool: Tool, geometry: Geometry, force_n: float, displacement_m: float) -> tuple[float, float]:
    calibration = tool.calibration
    beta0 = math.radians(geometry.beta0_deg)
    reach = displacement_m / geometry.l_jaw_m
    if not abs(reach) < 1:
        raise ValueError(f"displacement {displacement_m} m is beyond the jaw's length of {geometry.l_jaw_m} m")
    theta_jaw = math.asin(reach)
    angle = beta0 + theta_jaw
    crank = geometry.l2_m / geometry.l1_m * math.sin(angle)
    if not (0 < angle < math.pi and abs(crank) <= 1):
        raise ValueError(f"the linkage cannot reach a displacement of {displacement_m} m")
    lever = geometry.l2_m * geometry.r_pp_m / (2 * geometry.l_jaw_m * geometry.a_m)
    gain = lever * (crank + math.sin(angle)) * math.cos(theta_jaw) * calibration.newton_per_volt
    scale = calibration.jaw_force_scale
    strain_v = force_n / (scale.value if scale.law is ForceLaw.CONSTANT else gain * scale.value)

    # Eq. (6) is a quadratic in the rod position p: p^2 + b p + c = 0; the smaller root is the one with p = 0 at rest
    b = 2 * (geometry.l2_m * math.cos(angle) - geometry.l0_m)
    c = 2 * geometry.l2_m * geometry.l0_m * (math.cos(beta0) - math.cos(angle))
    discriminant = b * b - 4 * c
    if discriminant < 0:
        raise ValueError(f"the linkage cannot reach a displacement of {displacement_m} m")
    rod = (-b - math.sqrt(discriminant)) / 2
    theta_handle_deg = math.degrees(math.atan(rod / geometry.a_m))
    encoder_deg = theta_handle_deg / calibration.handle_per_encoder + calibration.encoder_deg_per_volt * strain_v
    return strain_v, encoder_deg
