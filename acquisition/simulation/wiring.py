"""The class MiswiredGrasper, which simulates wiring faults: a plant between simulated board and simulated grasper.

For a sensor that never worked, use `FaultySensors` with a fault at sample 0.
"""

import math
from enum import StrEnum

from acquisition.simulation.board import SensorReadings
from acquisition.simulation.grasper import TOUCH_ACTIVE_V, SimulatedGrasper

HUM_FREQUENCY_HZ, HUM_AMPLITUDE_V = 50.0, 0.4


class WiringFault(StrEnum):
    STRAIN_FLOATS = "strain gage: nothing drives the input"
    READBACK_OPEN = "motor command: not read back"
    READBACK_HALVED = "motor command: read back through a divider"
    TOUCH_STUCK = "touch sensors: stuck at contact"


class MiswiredGrasper:
    """A `Plant` with a wiring fault; `readback_v` returns the board's read-back of its own output."""

    def __init__(self, grasper: SimulatedGrasper, wiring_fault: WiringFault) -> None:
        self._grasper, self._wiring_fault = grasper, wiring_fault
        self._sample_count = 0

    def readback_v(self, command_v: float) -> float:
        share = {WiringFault.READBACK_OPEN: 0.0, WiringFault.READBACK_HALVED: 0.5}
        return share.get(self._wiring_fault, 1.0) * command_v

    def step(self, command_v: float) -> SensorReadings:
        """Simulate one sample, as `Plant.step`."""
        readings = self._grasper.step(command_v)
        self._sample_count += 1
        match self._wiring_fault:
            case WiringFault.STRAIN_FLOATS:
                readings["strain_v"] += HUM_AMPLITUDE_V * math.sin(
                    2 * math.pi * HUM_FREQUENCY_HZ * self._sample_count / 1000.0
                )
            case WiringFault.TOUCH_STUCK:
                readings |= {"touch_1_v": TOUCH_ACTIVE_V, "touch_2_v": TOUCH_ACTIVE_V}
        return readings
