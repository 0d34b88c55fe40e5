"""The check of lengths, gains and rates in a tool file by plausible ranges; a value outside is mostly in another unit.

The ranges are wide: they hold for any motorized grasper of this kind, and find values that are off by a unit.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from config.errors import ConfigurationError
from config.schema import Tool

_Conversion = tuple[str, Callable[[float], float]]  # what the value may be in, and the value in the file's unit


def _scaled(unit: str, factor: float) -> _Conversion:
    return f"in {unit}", lambda value: value * factor


def _inverted(what: str) -> _Conversion:
    return what, lambda value: 1.0 / value if value else math.inf


@dataclass(frozen=True, slots=True)
class PlausibleRange:
    """The plausible range of a value in a unit, and the units that it is mistaken for."""

    low: float
    high: float
    unit: str
    mistakes: tuple[_Conversion, ...] = ()

    def describe_fault(self, value: float) -> str | None:
        """Return why the value is not plausible, and what it may be; None if it is."""
        if self.low <= value <= self.high:
            return None
        guesses = []
        for what, convert in self.mistakes:
            meant = convert(value)
            if self.low <= meant <= self.high:
                guesses.append(f"if {value:g} is {what}, write {meant:.6g}")
        advice = "; ".join(guesses) if guesses else "check the value and its unit"
        return (
            f"{value:g} {self.unit} is not plausible, expected {self.low:g} to {self.high:g} {self.unit}: {advice}"
        ).replace("  ", " ")


_MM, _CM, _INCH = _scaled("mm", 1e-3), _scaled("cm", 1e-2), _scaled("inches", 0.0254)
_MILLI_V, _MS = _scaled("mV", 1e-3), _scaled("ms", 1e-3)
_RAD = _scaled("rad", math.degrees(1.0))


def _length(low: float, high: float) -> PlausibleRange:
    return PlausibleRange(low, high, "m", (_MM, _CM, _INCH))


def _voltage(low: float, high: float) -> PlausibleRange:
    return PlausibleRange(low, high, "V", (_MILLI_V,))


def _duration(low: float, high: float) -> PlausibleRange:
    return PlausibleRange(low, high, "s", (_MS,))


MAX_V = 10.6  # of NI boards, a little over 10 V
_FORCE = PlausibleRange(0.1, 100.0, "N", (_scaled("kN", 1e3), _scaled("mN", 1e-3), _scaled("grams-force", 9.80665e-3)))
_SCALE = PlausibleRange(0.001, 10.0, "", (_scaled("percent", 0.01), _scaled("mN/V", 1e-3)))
_STRETCH = PlausibleRange(
    1.0, 2000.0, "deg/V", (_scaled("rad/V", math.degrees(1.0)), _scaled("deg/mV", 1e3), _scaled("turns/V", 360.0))
)

_RATE = PlausibleRange(50.0, 250_000.0, "Hz", (_scaled("kHz", 1e3), _inverted("the period in s")))
_NEWTON_PER_VOLT = PlausibleRange(0.1, 500.0, "N/V", (_scaled("N/mV", 1e3), _scaled("mN/V", 1e-3), _inverted("in V/N")))

RANGES: dict[str, PlausibleRange] = {
    "board.sample_rate_hz": _RATE,
    "table.rate_hz": _RATE,
    "channels.analog_range_v": _voltage(0.1, MAX_V),
    "geometry.r_pp_m": _length(0.002, 0.3),
    "geometry.a_m": _length(0.0005, 0.1),
    "geometry.l0_m": _length(0.0005, 0.1),
    "geometry.l1_m": _length(0.0005, 0.1),
    "geometry.l2_m": _length(0.0005, 0.1),
    "geometry.l_jaw_m": _length(0.002, 0.15),
    "geometry.beta0_deg": PlausibleRange(1.0, 89.0, "deg", (_RAD,)),
    "geometry.opening_m": _length(0.0005, 0.1),
    "kinematics.opening_m": _length(0.0005, 0.1),
    "kinematics.stretch_deg_per_volt": _STRETCH,
    "kinematics.newton_per_volt": _NEWTON_PER_VOLT,
    "kinematics.metre_per_degree": PlausibleRange(1e-6, 0.01, "m/deg", (_MM, _scaled("m/rad", math.radians(1.0)))),
    "kinematics.jaw_per_handle": PlausibleRange(0.002, 20.0, ""),
    "kinematics.handle_arm_m": _length(0.0005, 0.5),
    "kinematics.jaw_arm_m": _length(0.002, 0.15),
    "kinematics.strain_v": PlausibleRange(-MAX_V, MAX_V, "V", (_MILLI_V,)),
    "kinematics.force_n": PlausibleRange(-100.0, 100.0, "N", (_scaled("mN", 1e-3),)),
    "kinematics.encoder_deg": PlausibleRange(-36_000.0, 36_000.0, "deg"),
    "kinematics.displacement_m": PlausibleRange(-0.1, 0.1, "m", (_MM, _CM, _INCH)),
    "calibration.newton_per_volt": _NEWTON_PER_VOLT,
    "calibration.encoder_deg_per_volt": _STRETCH,
    "calibration.handle_per_encoder": PlausibleRange(
        0.002, 2.0, "", (_inverted("degrees of the encoder per degree of the handle"), _scaled("percent", 0.01))
    ),
    "calibration.jaw_force_scale.value": _SCALE,
    "calibration.jaw_force_scale.low": _SCALE,
    "calibration.jaw_force_scale.high": _SCALE,
    "calibration.rest_offset_v": PlausibleRange(-MAX_V, MAX_V, "V", (_MILLI_V,)),
    "calibration.rest_tolerance_v": _voltage(0.0005, 2.0),
    "calibration.encoder_counts_per_rev": PlausibleRange(8, 100_000, "pulses"),
    "calibration.encoder_gear_ratio": PlausibleRange(
        0.2, 2000.0, "", (_inverted("turns of the gearbox per turn of the encoder"),)
    ),
    "noise.strain_sd_v": _voltage(1e-6, 0.3),
    "noise.strain_lsb_v": _voltage(0.0, 0.1),
    "limits.max_command_v": _voltage(0.05, MAX_V),
    "limits.max_command_v_per_s": PlausibleRange(0.2, 10_000.0, "V/s", (_scaled("V/ms", 1e3), _scaled("mV/s", 1e-3))),
    "limits.force_ceiling_n": _FORCE,
    "limits.max_run_s": _duration(1.0, 100_000.0),
    "command_to_force.command_v": _voltage(0.0, MAX_V),
    "command_to_force.force_n": PlausibleRange(0.0, 100.0, "N", (_scaled("mN", 1e-3),)),
    "contact.touch_threshold_v": _voltage(0.01, MAX_V),
    "contact.force_rise_v": _voltage(0.0001, 2.0),
    "contact.wall_above_v": _voltage(0.001, MAX_V),
    "contact.wall_span_v": _voltage(0.001, MAX_V),
    "contact.wall_slack_deg_per_volt": PlausibleRange(
        0.2, 500.0, "deg/V", (_scaled("rad/V", math.degrees(1.0)), _scaled("deg/mV", 1e3))
    ),
    "contact.walk_deg": PlausibleRange(5.0, 36_000.0, "deg", (_RAD, _scaled("turns", 360.0))),
    "channels.position.degree_per_volt": PlausibleRange(
        -3600.0, 3600.0, "deg/V", (_scaled("rad/V", math.degrees(1.0)), _scaled("deg/mV", 1e3))
    ),
    "hand_driven.closing_deg": PlausibleRange(0.05, 36_000.0, "deg", (_RAD, _scaled("turns", 360.0))),
    "plausible.strain_step_v": _voltage(0.001, MAX_V),
    "plausible.strain_scatter_v": _voltage(0.001, MAX_V),
    "plausible.strain_below_rest_v": _voltage(0.001, MAX_V),
    "plausible.rest_drift_v": _voltage(0.001, MAX_V),
    "plausible.encoder_step_deg": PlausibleRange(0.1, 3600.0, "deg", (_RAD, _scaled("turns", 360.0))),
    "plausible.encoder_back_deg": PlausibleRange(1.0, 36_000.0, "deg", (_RAD, _scaled("turns", 360.0))),
    "plausible.encoder_stuck_v": _voltage(0.001, MAX_V),
    "simulation.drive_lag_s": _duration(0.0001, 1.0),
    "simulation.contact_lag_s": _duration(0.0001, 1.0),
    "simulation.free_drag_kg_per_s": PlausibleRange(0.1, 1000.0, "kg/s", (_scaled("g/s", 1e-3),)),
    "simulation.free_travel_m": _length(1e-6, 0.05),
    "simulation.opening_time_s": _duration(0.001, 5.0),
}
MAY_BE_ZERO = ("calibration.encoder_deg_per_volt", "kinematics.stretch_deg_per_volt")  # a rod does not stretch


def check_plausible(tool: Tool, where: str) -> None:
    """Refuse a tool with a value outside its plausible range.

    Raises:
        ConfigurationError: the text has a line for each value, with the unit that it is likely in.
    """
    faults = []
    for key, plausible in RANGES.items():
        for value in _read_values(tool, key):
            if key in MAY_BE_ZERO and value == 0.0:
                continue
            if fault := plausible.describe_fault(value):
                faults.append(f"{where}: {key}: {fault}")
                break
    if faults:
        raise ConfigurationError("\n".join([f"{len(faults)} fault{'s'[: len(faults) != 1]} to mend:", *faults]))


def _read_values(tool: Tool, key: str) -> tuple[float, ...]:
    """Return the values of a key, one or several; none where the tool leaves it out."""
    value: Any = tool
    for part in key.split("."):
        value = getattr(value, part, None)
        if value is None:
            return ()
    return value if isinstance(value, tuple) else (value,)
