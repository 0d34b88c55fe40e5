"""The class ProtocolPlayer, which gives the motor command that a protocol asks for, sample by sample."""

import numpy as np

from config.errors import RefusedError
from config.schema import (
    ByHandWaveform,
    CommandToForce,
    CustomWaveform,
    GraspProtocol,
    SineWaveform,
    Tool,
    TrapezoidWaveform,
)

MIN_GRASP_SAMPLES = 20
MAX_CYCLE_SAMPLES = 300_000
"""Bounds the time for computing a command, 35 ms: the acquisition computes it between two blocks."""
ROUNDING_TOLERANCE = 1e-9


def build_cycle_command(protocol: GraspProtocol, tool: Tool) -> np.ndarray:
    """Return the command of one grasp and its rest, V, shape (n,), at the tool's sample rate; it begins at 0.

    Raises:
        RefusedError: the command exceeds the tool's limits or rises faster than they allow.
    """
    waveform = protocol.waveform
    rate_hz = tool.board.sample_rate_hz
    if not protocol.is_for(tool):
        advice = "is for tools without a motor" if tool.has_motor else "drives a motor, which this tool lacks"
        raise RefusedError(f"The protocol {protocol.name!r} {advice}. Choose another one.")
    if waveform.cycle_s > tool.limits.max_run_s:
        raise RefusedError(
            f"One cycle of {protocol.name!r} takes {waveform.cycle_s:.3g} s; the tool {tool.name!r} allows at most "
            f"{tool.limits.max_run_s:.0f} s. Shorten it or choose another protocol."
        )
    if isinstance(waveform, ByHandWaveform):
        return np.broadcast_to(0.0, round(waveform.cycle_s * rate_hz))
    if round(waveform.cycle_s * rate_hz) > MAX_CYCLE_SAMPLES:
        raise RefusedError(
            f"One cycle of {protocol.name!r} takes {waveform.cycle_s:.3g} s; at {rate_hz:.0f} samples a second at most "
            f"{MAX_CYCLE_SAMPLES / rate_hz:.0f} s can be played. Shorten it or choose another protocol."
        )
    if waveform.grasp_s * rate_hz < MIN_GRASP_SAMPLES:
        raise RefusedError(
            f"A grasp of {protocol.name!r} takes {waveform.grasp_s:.3g} s, which is too short to be followed at "
            f"{rate_hz:.0f} samples a second. Make it at least {MIN_GRASP_SAMPLES / rate_hz:.3g} s."
        )
    time_s = np.arange(round(waveform.cycle_s * rate_hz)) / rate_hz
    match waveform:
        case TrapezoidWaveform():
            corners = np.cumsum([0.0, waveform.ramp_up_s, waveform.hold_s, waveform.ramp_down_s])
            command = np.interp(time_s, corners, [0.0, waveform.peak_v, waveform.peak_v, 0.0])
        case CustomWaveform():
            command = np.interp(time_s, waveform.time_s, waveform.command_v)
        case SineWaveform():
            command = _sine_command(waveform, tool.command_to_force, time_s)
    if not np.isfinite(command).all():
        raise RefusedError(
            f"Protocol {protocol.name!r} gives no motor command at {rate_hz:.0f} samples a second: a number in it is "
            "too large. Correct it or choose another protocol."
        )
    peak_v = float(command.max())
    if peak_v > tool.limits.max_command_v:
        raise RefusedError(
            f"Protocol {protocol.name!r} asks for {peak_v:.2f} V; the tool {tool.name!r} allows at most "
            f"{tool.limits.max_command_v:.2f} V. Lower its peak or choose another protocol."
        )
    fastest_v_per_s = float(np.diff(command).max()) * rate_hz
    if fastest_v_per_s > tool.limits.max_command_v_per_s * (1 + ROUNDING_TOLERANCE):
        raise RefusedError(
            f"Protocol {protocol.name!r} rises by {fastest_v_per_s:.1f} V/s; the tool {tool.name!r} allows at most "
            f"{tool.limits.max_command_v_per_s:.1f} V/s. Make its ramps longer or lower, or choose another protocol."
        )
    return command


def _sine_command(waveform: SineWaveform, command_to_force: CommandToForce, time_s: np.ndarray) -> np.ndarray:
    """Return the command for a raised cosine of force, A/2 (1 - cos 2 pi f t): one slow cycle, then fast ones."""
    first_s = 1.0 / waveform.first_hz
    with np.errstate(over="ignore", invalid="ignore"):  # the caller refuses values that are not finite
        cycles = np.where(time_s < first_s, time_s * waveform.first_hz, (time_s - first_s) * waveform.then_hz)
        force = waveform.peak_n / 2 * (1 - np.cos(2 * np.pi * cycles))
    return np.where(time_s < waveform.grasp_s, command_to_force.to_command_v(force), 0.0)


class ProtocolPlayer:
    """Player of a protocol's cycles, one command a call; `done` after the last rest."""

    def __init__(self, protocol: GraspProtocol, tool: Tool, cycles: int) -> None:
        cycle = build_cycle_command(protocol, tool)
        lead_in = round(protocol.lead_in_s * tool.board.sample_rate_hz)
        duration_s = (lead_in + cycles * len(cycle)) / tool.board.sample_rate_hz
        if duration_s > tool.limits.max_run_s:
            raise RefusedError(
                f"{cycles} cycles of {protocol.name!r} take {duration_s:.0f} s; the tool {tool.name!r} allows at most "
                f"{tool.limits.max_run_s:.0f} s. Ask for fewer cycles.",
                field="cycles",
            )
        self._cycle, self._lead_in, self._cycles = cycle, lead_in, cycles
        self._position = 0

    @property
    def total_samples(self) -> int:
        """Number of samples of the whole run, with the lead-in."""
        return self._lead_in + self._cycles * len(self._cycle)

    @property
    def at_start(self) -> bool:
        return self._position == 0

    @property
    def in_lead_in(self) -> bool:
        return self._position < self._lead_in

    @property
    def done(self) -> bool:
        return self._position >= self.total_samples

    def next_command(self, samples: int) -> float:
        """Return the first command of the next `samples` samples, V, and advance; 0 in the lead-in and at the end."""
        at, self._position = self._position - self._lead_in, self._position + samples
        if at < 0 or at >= self._cycles * len(self._cycle):
            return 0.0
        return float(self._cycle[at % len(self._cycle)])
