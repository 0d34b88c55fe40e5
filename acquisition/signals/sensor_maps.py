"""Maps from a sensor's reading to force or displacement of the jaws, of all kinematics but the Smart Tool's.

The force sensor's map gives the jaw force, and the position sensor's the jaw displacement. Each map knows its slope, so
that the noise of its sensor can be converted, and its inverse, for the simulation.
"""

import functools
import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from config.schema import DirectKinematics, LeverKinematics, TableKinematics, Tool


class SensorMap(Protocol):
    """A monotone function of a sensor's reading."""

    def evaluate(self, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return value and slope, of the shape of the reading; NaN where the reading is outside the domain."""
        ...

    def invert(self, value: float) -> float:
        """Return the reading for a value.

        Raises:
            ValueError: no reading gives the value; the text says the limit.
        """
        ...


@dataclass(frozen=True, slots=True)
class ProportionalMap:
    """The reading times `gain`."""

    gain: float

    def evaluate(self, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.gain * reading, np.full(np.shape(reading), self.gain)

    def invert(self, value: float) -> float:
        return value / self.gain


@dataclass(frozen=True, slots=True)
class TableMap:
    """The monotone curve through measured pairs, times `scale`; valid between the first pair and the last.

    Source: Fritsch and Butland's piecewise cubic (SciPy's PCHIP), which overshoots nowhere.
    """

    readings: tuple[float, ...]
    values: tuple[float, ...]
    scale: float = 1.0

    def evaluate(self, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        curve, slope = _fit_curve(self.readings, self.values)
        return self.scale * curve(reading), self.scale * slope(reading)

    def invert(self, value: float) -> float:
        at = value / self.scale
        if not min(self.values) <= at <= max(self.values):
            raise ValueError(f"{value:g} is beyond the table: {min(self.values):g} to {max(self.values):g}")
        curve, _ = _fit_curve(self.readings, self.values)
        return float(curve.solve(at, extrapolate=False)[0])


@functools.lru_cache(maxsize=8)
def _fit_curve(readings: tuple[float, ...], values: tuple[float, ...]) -> tuple[Any, Any]:
    """Return the curve and its derivative, which are NaN beyond the pairs."""
    from scipy.interpolate import PchipInterpolator  # the import takes most of a second, and most tools need none

    curve = PchipInterpolator(readings, values, extrapolate=False)
    return curve, curve.derivative()


def build_sensor_maps(tool: Tool) -> tuple[SensorMap, SensorMap]:
    """Return the maps of a tool's force sensor (V over rest to N) and position sensor (degrees to m).

    Raises:
        ValueError: the tool has the Smart Tool's kinematics, whose force depends on both sensors.
    """
    scale = tool.calibration.jaw_force_scale
    force: SensorMap
    match tool.kinematics:
        case DirectKinematics() as direct:
            force = ProportionalMap(scale.value * direct.newton_per_volt)
            motion = ProportionalMap(direct.metre_per_degree)
        case LeverKinematics() as lever:  # handle and jaws do the same work
            arms = lever.handle_arm_m / (lever.jaw_arm_m * lever.jaw_per_handle)
            force = ProportionalMap(scale.value * lever.newton_per_volt * arms)
            motion = ProportionalMap(lever.jaw_arm_m * math.radians(lever.jaw_per_handle))
        case TableKinematics() as table:
            force = TableMap(table.strain_v, table.force_n, scale.value)
            motion = TableMap(table.encoder_deg, table.displacement_m)
        case other:
            raise ValueError(f"kinematics {other.kind!r} have no maps of single sensors")
    return force, motion
