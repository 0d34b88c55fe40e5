"""The class FaultySensors, which simulates sensor faults: a plant between simulated board and simulated grasper."""

import math
import threading
from collections.abc import Callable
from enum import StrEnum

import numpy as np

from acquisition.simulation.board import Plant, SensorReadings
from config.schema import Tool

SPIKE_V = 3.0
JUMP_V = -0.25
NOISE_FACTOR = 20.0
DROP_OUT_V = 0.0
JUMP_DEG = 60.0
SLIP_SHARE = 0.3
"""Share of its motion that a slipping encoder still shows."""


class SensorFault(StrEnum):
    STRAIN_STUCK = "strain gage stuck"
    STRAIN_SATURATED = "strain gage saturated"
    STRAIN_SPIKE = "strain gage: one spike"
    STRAIN_DROP_OUT = "strain gage drops out"
    STRAIN_JUMP = "strain gage: offset jumps"
    STRAIN_NOISE = "strain gage: noise x 20"
    STRAIN_NAN = "strain gage: no number"
    ENCODER_STUCK = "encoder stuck"
    ENCODER_SLIPS = "encoder slips"
    ENCODER_REVERSED = "encoder reversed"
    ENCODER_JUMP = "encoder jumps"


class FaultySensors:
    """A `Plant` with sound sensors until a fault is injected, from any thread; `fault_sample` is its first sample."""

    def __init__(self, plant: Plant, tool: Tool, seed: int = 0) -> None:
        self._plant, self._tool = plant, tool
        self._rng = np.random.default_rng([seed, 3])
        self._lock = threading.Lock()
        self._fault: SensorFault | None = None
        self._last_readings: SensorReadings = {"strain_v": 0.0, "encoder_deg": 0.0}
        self._frozen_readings: SensorReadings = self._last_readings
        self.sample_count = 0
        self.fault_sample: int | None = None

    def inject_fault(self, fault: SensorFault) -> None:
        """Inject a fault from the next sample on."""
        self.inject_fault_at(fault, self.sample_count)

    def inject_fault_at(self, fault: SensorFault, sample: int) -> None:
        """Inject a fault from this sample on, counted from 0."""
        with self._lock:
            self._fault, self.fault_sample = fault, sample

    def clear_fault(self) -> None:
        with self._lock:
            self._fault = None

    def step(self, command_v: float) -> SensorReadings:
        """Simulate one sample, as `Plant.step`."""
        with self._lock:
            if self.sample_count == self.fault_sample:
                self._frozen_readings = self._last_readings
            self._last_readings = self._plant.step(command_v)
            self.sample_count += 1
            if self._fault is None or self.fault_sample is None or self.sample_count <= self.fault_sample:
                return self._last_readings
            return self._apply_fault(self._last_readings, self._fault)

    def _apply_fault(self, sound: SensorReadings, fault: SensorFault) -> SensorReadings:
        strain_v, encoder_deg = sound["strain_v"], sound["encoder_deg"]
        stuck_v, stuck_deg = self._frozen_readings["strain_v"], self._frozen_readings["encoder_deg"]
        moved_deg = encoder_deg - stuck_deg
        noise_v = math.sqrt(NOISE_FACTOR**2 - 1.0) * self._tool.noise.strain_sd_v
        is_first = self.sample_count - 1 == self.fault_sample
        strain: dict[SensorFault, Callable[[], float]] = {
            SensorFault.STRAIN_STUCK: lambda: stuck_v,
            SensorFault.STRAIN_SATURATED: lambda: self._tool.channels.analog_range_v,
            SensorFault.STRAIN_SPIKE: lambda: strain_v + SPIKE_V if is_first else strain_v,
            SensorFault.STRAIN_DROP_OUT: lambda: DROP_OUT_V,
            SensorFault.STRAIN_JUMP: lambda: strain_v + JUMP_V,
            SensorFault.STRAIN_NOISE: lambda: strain_v + noise_v * float(self._rng.standard_normal()),
            SensorFault.STRAIN_NAN: lambda: math.nan,
        }
        encoder: dict[SensorFault, Callable[[], float]] = {
            SensorFault.ENCODER_STUCK: lambda: stuck_deg,
            SensorFault.ENCODER_SLIPS: lambda: stuck_deg + SLIP_SHARE * moved_deg,
            SensorFault.ENCODER_REVERSED: lambda: stuck_deg - moved_deg,
            SensorFault.ENCODER_JUMP: lambda: encoder_deg + JUMP_DEG,
        }
        if fault in strain:
            return sound | {"strain_v": strain[fault]()}
        return sound | {"encoder_deg": encoder[fault]()}
