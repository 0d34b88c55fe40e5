"""The class SelfTest, part of arming: strain gage at its tare, quiet and live sensors, command line at zero."""

from collections import deque

import numpy as np

from acquisition.sample_block import SAMPLE_DTYPE
from acquisition.signals.grasp_tracker import COMMAND_ON_V
from config.schema import Tool

WINDOW_SAMPLES = 200
TIMEOUT_SAMPLES = 1_000
"""Time limit for the jaws to come to rest."""
NOISE_RANGE_SHARE = (0.1, 5.0)
"""Plausible noise at rest as a share of the tool file's; quiet baselines of the 2013 recordings: 0.5 to 2.5."""
MAX_REST_MOTION_DEG = 1.0


def compute_noise_range_v(tool: Tool) -> tuple[float, float]:
    """Return the lowest and highest standard deviation of a sound strain gage at rest, V."""
    least, most = NOISE_RANGE_SHARE
    return least * tool.noise.strain_sd_v, most * tool.noise.strain_sd_v


class SelfTest:
    """Self-test at rest: a window of the last samples, and the checks on them."""

    def __init__(self, tool: Tool) -> None:
        self._tool = tool
        self._recent_blocks: deque[np.ndarray] = deque()
        self._elapsed_samples = 0

    def start(self) -> None:
        self._elapsed_samples = 0

    def append(self, samples: np.ndarray) -> None:
        """Add a block of dtype SAMPLE_DTYPE."""
        self._recent_blocks.append(samples)
        while sum(map(len, self._recent_blocks)) - len(self._recent_blocks[0]) >= WINDOW_SAMPLES:
            self._recent_blocks.popleft()
        self._elapsed_samples += len(samples)

    @property
    def timed_out(self) -> bool:
        """Whether the time limit has passed."""
        return self._elapsed_samples > TIMEOUT_SAMPLES

    def find_fault_at_rest(self) -> str | None:
        """Return the first fault in the last samples with advice, or None if the tool may be armed."""
        samples = np.concatenate(self._recent_blocks, dtype=SAMPLE_DTYPE)
        if len(samples) < WINDOW_SAMPLES:
            return "the tool has not been watched long enough: try again"
        tool, strain_v = self._tool, samples["strain_v"]
        command_v = float(np.abs(samples["motor_command_v"]).max())
        if not command_v < COMMAND_ON_V:
            return f"the motor command is read back as {command_v:.2f} V instead of 0 V: check its wiring"
        if not (np.isfinite(strain_v).all() and np.isfinite(samples["encoder_deg"]).all()):
            return "a sensor gives no number: check its wiring"
        rest_v, calibration = float(np.median(strain_v)), tool.calibration
        if not calibration.is_rest_voltage(rest_v):
            return (
                f"the strain gage rests at {rest_v:.3f} V, the tool file expects {calibration.rest_offset_v:.3f} V "
                f"within {calibration.rest_tolerance_v:.3f} V: open the jaws, or calibrate anew"
            )
        noise_v, (least, most) = float(strain_v.std()), compute_noise_range_v(tool)
        if not least <= noise_v <= most:
            return (
                f"the strain gage scatters by {noise_v * 1e3:.2f} mV at rest, a sound one by {least * 1e3:.2f} to "
                f"{most * 1e3:.2f} mV: wait until the jaws rest, then check its cable and amplifier"
            )
        moved_deg = float(np.ptp(samples["encoder_deg"]))
        if not moved_deg < MAX_REST_MOTION_DEG:
            return f"the encoder moved by {moved_deg:.1f} degrees at rest: wait until the jaws rest, then try again"
        touched_v = float(max(samples["touch_1_v"].min(), samples["touch_2_v"].min()))
        if tool.contact.touch_trusted and touched_v > tool.contact.touch_threshold_v:
            return "a touch sensor tells contact while the jaws are open: take out what they hold, or check the sensor"
        return None
