"""The class SensorMonitor, which finds implausible readings: force or jaws are unknown, and the motor must stop."""

import math
from collections import deque

import numpy as np

from acquisition.sample_block import SampleFlag
from acquisition.signals.grasp_tracker import COMMAND_ON_V
from config.schema import Tool

STUCK_SAMPLES = 10
"""Equal readings in a row that count as stuck. Noise of 12 steps of the converter makes two equal readings in 2 % of
cases; the 2013 recordings have 5 in a row at most.
"""
MEDIAN_SAMPLES = 3
SCATTER_SAMPLES = 7
REST_SETTLING_S = 0.3
"""Time after the command's return to zero until the strain gage is back at its tare."""
REST_SAMPLES = 50
STUCK_TOLERANCE_COUNTS = 2.5
"""Motion of the encoder that counts as standing still, for readings that flicker."""

IN_GRASP = SampleFlag.IN_GRASP.value


class SensorMonitor:
    """Monitor of strain gage, encoder and command, sample by sample.

    The limits are the tool file's `plausible`; the tool's own vibration, noise and speed stay within them.
    """

    def __init__(self, tool: Tool) -> None:
        self._limits = tool.plausible
        self._stuck_tolerance_deg = STUCK_TOLERANCE_COUNTS * tool.calibration.encoder_resolution_deg
        self._stretch_deg_per_volt = tool.stretch_deg_per_volt
        self._settled_samples = round(REST_SETTLING_S * tool.board.sample_rate_hz)
        self.reset()

    def reset(self) -> None:
        """Forget earlier samples; call this after a new tare or a gap."""
        self._strain_v: deque[float] = deque(maxlen=2 * MEDIAN_SAMPLES)
        self._scatter_v: deque[float] = deque(maxlen=SCATTER_SAMPLES)
        self._at_rest_v: deque[float] = deque(maxlen=REST_SAMPLES)
        self._repeated_readings = 0
        self._encoder_deg = self._encoder_zero_deg = math.nan
        self._stuck_encoder_deg = self._stuck_strain_v = math.nan
        self._rest_samples, self._max_command_v = 0, 0.0

    def check(self, samples: np.ndarray, rest_v: float) -> str | None:
        """Return why the samples cannot be true, or None; `rest_v` is the tare, V.

        The samples (dtype SAMPLE_DTYPE) follow the last ones without a gap. All are processed, also after a fault.
        """
        why = None
        columns = (samples["strain_v"], samples["encoder_deg"], samples["motor_command_v"], samples["flags"])
        for strain_v, encoder_deg, command_v, flags in zip(*(column.tolist() for column in columns), strict=True):
            if not math.isfinite(strain_v):
                why = why or "the strain gage gives no number: check its wiring"
                self.reset()
                continue
            found = self._check_strain(strain_v, rest_v, command_v)
            found = found or self._check_encoder(encoder_deg, command_v, rest_v, is_grasped=bool(flags & IN_GRASP))
            why = why or found
        return why

    def _check_strain(self, strain_v: float, rest_v: float, command_v: float) -> str | None:
        limits, recent = self._limits, self._strain_v
        self._repeated_readings = self._repeated_readings + 1 if recent and strain_v == recent[-1] else 0
        recent.append(strain_v)
        if self._repeated_readings >= STUCK_SAMPLES - 1:
            return f"the strain gage is stuck at {strain_v:.3f} V: check its wiring and amplifier"
        if len(recent) < 2 * MEDIAN_SAMPLES:
            return None
        *before, last_but_two_v, last_but_one_v, last_v = recent
        now_v = _median_of_three(last_but_two_v, last_but_one_v, last_v)
        step_v = now_v - _median_of_three(*before)
        if abs(step_v) > limits.strain_step_v:
            return f"the strain gage jumped by {step_v:+.3f} V, faster than any force: check its wiring"
        if now_v - rest_v < -limits.strain_below_rest_v:
            return f"the strain gage reads {rest_v - now_v:.3f} V below its rest: check its wiring"
        self._scatter_v.append(abs(last_v - 2.0 * last_but_one_v + last_but_two_v))
        if len(self._scatter_v) == SCATTER_SAMPLES:
            scatter_v = sorted(self._scatter_v)[SCATTER_SAMPLES // 2]
            if scatter_v > limits.strain_scatter_v:
                return f"the strain gage scatters by {scatter_v:.3f} V from sample to sample: check its cable"
        return self._check_rest(strain_v, rest_v, command_v)

    def _check_rest(self, strain_v: float, rest_v: float, command_v: float) -> str | None:
        """Check that the strain returns to the tare between grasps; a gage that jumped in a grasp does not."""
        if command_v > COMMAND_ON_V:
            self._rest_samples = 0
            self._at_rest_v.clear()
            return None
        self._rest_samples += 1
        if self._rest_samples <= self._settled_samples:
            return None
        self._at_rest_v.append(strain_v)
        if len(self._at_rest_v) < REST_SAMPLES:
            return None
        off_v = sorted(self._at_rest_v)[REST_SAMPLES // 2] - rest_v
        self._at_rest_v.clear()
        if abs(off_v) > self._limits.rest_drift_v:
            return f"the strain gage rests {off_v:+.3f} V off its tare: the force is not known; arm anew"
        return None

    def _check_encoder(self, encoder_deg: float, command_v: float, rest_v: float, *, is_grasped: bool) -> str | None:
        limits, before_deg = self._limits, self._encoder_deg
        if not math.isfinite(encoder_deg):
            return "the encoder gives no number: check its wiring"
        self._encoder_deg = encoder_deg
        if not is_grasped:
            self._encoder_zero_deg, self._max_command_v = encoder_deg, 0.0
        step_deg = encoder_deg - before_deg
        if abs(step_deg) > limits.encoder_step_deg:
            return f"the encoder jumped by {step_deg:+.1f} degrees, faster than the motor turns: check its wiring"
        if len(self._strain_v) < 2 * MEDIAN_SAMPLES:
            return None
        strain_v = sorted(self._strain_v)[MEDIAN_SAMPLES]
        self._max_command_v = max(self._max_command_v, command_v)
        if is_grasped and command_v >= self._max_command_v - COMMAND_ON_V:
            # Eq. (3): stretch of the cable, which does not move the jaws
            stretch_deg = self._stretch_deg_per_volt * (strain_v - rest_v)
            closed_deg = encoder_deg - self._encoder_zero_deg - stretch_deg
            if closed_deg < -limits.encoder_back_deg:
                return f"the encoder tells jaws {-closed_deg:.0f} degrees wider open than at rest: check its wiring"
        return self._check_encoder_stuck(encoder_deg, strain_v)

    def _check_encoder_stuck(self, encoder_deg: float, strain_v: float) -> str | None:
        """Check that the encoder turns when the strain changes: force stretches the cable, which turns it."""
        if not abs(encoder_deg - self._stuck_encoder_deg) < self._stuck_tolerance_deg:
            self._stuck_encoder_deg, self._stuck_strain_v = encoder_deg, strain_v
        change_v = strain_v - self._stuck_strain_v
        if abs(change_v) > self._limits.encoder_stuck_v:
            return f"the encoder stands still while the strain changes by {change_v:+.3f} V: check its wiring"
        return None


def _median_of_three(a: float, b: float, c: float) -> float:
    return max(min(a, b), min(max(a, b), c))
