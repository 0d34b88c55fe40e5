"""Functions that check signals and return a CheckResult; a failure's text names the likely mistake and what to do."""

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from acquisition.drivers.nidaq import READ_TIMEOUT_MARGIN_S, BoardInfo
from acquisition.safety.self_test import MAX_REST_MOTION_DEG, compute_noise_range_v
from acquisition.signal_table import find_analog_inputs
from acquisition.signals.grasp_tracker import COMMAND_ON_V
from config.schema import CALIBRATION_COMMANDS, FORCE_SCALE_KEY, Tool

RATE_TOLERANCE = 1e-3  # crystals are a hundred times better; a clock of another source is not
MAX_LATENESS_MS = 1e3 * READ_TIMEOUT_MARGIN_S
SATURATION_SHARE = 0.99
UNCONNECTED_V = 0.02  # a line that stays within this of zero is not connected
MAINS_HZ = (50.0, 60.0)
MAINS_SHARE = 0.5  # of the variance, within 2 Hz: an open input picks up the mains
READBACK_GAIN_TOLERANCE = 0.02
READBACK_OFFSET_TOLERANCE_V = 0.01
MAX_ROUND_TRIP_MS = 20.0
MIN_TURN_DEG = 5.0  # of the encoder while empty jaws close
SCALE_TOLERANCE = 0.1
MIN_STRAIN_CHANGE_V = 0.03  # change of the strain that is needed to check the encoder's scale


class CheckOutcome(StrEnum):
    PASS = "pass"
    FAIL = "fail"
    NOT_DONE = "not done"


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Result of one check; a failure's text says what to do."""

    check: str
    outcome: CheckOutcome
    text: str
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RawSignals:
    """Raw signals of n consecutive samples, each of shape (n,): volts, and degrees of the encoder."""

    strain_v: np.ndarray
    readback_v: np.ndarray
    touch_v: tuple[np.ndarray, np.ndarray]
    encoder_deg: np.ndarray


def check_product(board: BoardInfo, tool: Tool) -> CheckResult:
    """Check that the board is the one that the tool file is written for; return the result."""
    check, wanted = "board", tool.board.product
    if board.product == wanted:
        return CheckResult(check, CheckOutcome.PASS, f"{tool.board.device} is a {board.product}")
    text = (
        f"{tool.board.device} is a {board.product}, the tool file is for a {wanted}: choose the other in `device` "
        "under [board], or see that channels and ranges fit this one and correct `product`."
    )
    return CheckResult(check, CheckOutcome.FAIL, text)


def check_channels_exist(board: BoardInfo, tool: Tool) -> CheckResult:
    """Check that the board has the channels and the range of the tool file, and no input twice; return the result."""
    check, named = "channels", tool.channels
    inputs = list(find_analog_inputs(named).values())
    missing = [each for each in inputs if each not in board.analog_inputs]
    missing += [named.motor_command] * (named.motor_command not in ("", *board.analog_outputs))
    missing += [named.encoder] * (named.encoder not in ("", *board.counters))
    if missing:
        there = ", ".join((*board.analog_inputs, *board.analog_outputs, *board.counters))
        text = f"the board has no {', '.join(missing)}: correct the names under [channels]. It has {there}."
        return CheckResult(check, CheckOutcome.FAIL, text)
    if twice := {each for each in inputs if inputs.count(each) > 1}:
        text = f"{', '.join(sorted(twice))} stands for two signals: correct the names under [channels]."
        return CheckResult(check, CheckOutcome.FAIL, text)
    if not any(abs(each - named.analog_range_v) < 1e-6 for each in board.input_ranges_v):
        ranges = ", ".join(f"{each:g}" for each in sorted(set(board.input_ranges_v)))
        text = f"the board has no range of {named.analog_range_v:g} V: set `analog_range_v` to one of {ranges} V."
        return CheckResult(check, CheckOutcome.FAIL, text)
    others = ", output" * bool(named.motor_command) + ", encoder" * bool(named.encoder)
    return CheckResult(check, CheckOutcome.PASS, f"{len(inputs)} inputs up to {named.analog_range_v:g} V{others}")


def check_calibration(tool: Tool, today: datetime.date) -> CheckResult:
    """Check that no constant of the tool has expired; return the result."""
    check = "calibration"
    if expired := tool.find_expired_constants(today):
        names = ", ".join(f"{each.constant} of {each.date}, on {each.expires}" for each in expired)
        commands = CALIBRATION_COMMANDS | {FORCE_SCALE_KEY: "force"}
        what = ", ".join(
            f"`graspwatch calibrate {each}`" for each in dict.fromkeys(commands[e.constant] for e in expired)
        )
        return CheckResult(check, CheckOutcome.FAIL, f"expired: {names}. Measure these anew: {what}.")
    dates = sorted(each.expires for each in tool.constant_origins if each.expires)
    found = f"the oldest constant is of {min(each.date for each in tool.constant_origins)}"
    return CheckResult(
        check, CheckOutcome.PASS, f"{found}, {f'all are good until {dates[0]}' if dates else 'none expires'}"
    )


def check_force_scale(tool: Tool) -> CheckResult:
    """Check that the tool's force scale is measured; return the result."""
    check = "force scale"
    if tool.has_known_scale:
        return CheckResult(check, CheckOutcome.PASS, tool.scale_text)
    text = (
        f"{tool.scale_text}: the tool is not armed before it is. Put a load cell between the jaws, and measure it "
        "with `graspwatch calibrate force`."
    )
    return CheckResult(check, CheckOutcome.FAIL, text)


def measure_rate_and_lateness(ticks: np.ndarray, arrived_ns: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the measured sample rate, Hz, and each block's delay behind the most punctual one, ms, sorted, (n,)."""
    measured_hz = 1e9 / float(np.polyfit(ticks, arrived_ns - arrived_ns[0], 1)[0])
    behind_ns = arrived_ns - ticks * (1e9 / measured_hz)
    return measured_hz, np.sort(behind_ns - behind_ns.min()) / 1e6


def check_sample_clock(ticks: np.ndarray, arrived_ns: np.ndarray, rate_hz: float) -> CheckResult:
    """Check the rate and lateness of n blocks; return the result.

    Of each block: `ticks`, (n,), is the tick after its last sample, `arrived_ns`, (n,), its time of reading, ns.
    """
    check = "sample clock"
    measured_hz, late_ms = measure_rate_and_lateness(ticks, arrived_ns)
    figures = {
        "rate_hz": measured_hz,
        "late_median_ms": float(np.median(late_ms)),
        "late_99_ms": float(np.quantile(late_ms, 0.99)),
        "late_longest_ms": float(late_ms[-1]),
    }
    if abs(measured_hz / rate_hz - 1) > RATE_TOLERANCE:
        return CheckResult(
            check,
            CheckOutcome.FAIL,
            f"{measured_hz:.1f} samples a second come instead of {rate_hz:.0f}: see that nothing "
            "else drives the board's sample clock, and that `sample_rate_hz` is one that it can make.",
            figures,
        )
    if late_ms[-1] > MAX_LATENESS_MS:
        return CheckResult(
            check,
            CheckOutcome.FAIL,
            f"a block came {late_ms[-1]:.1f} ms late, and {MAX_LATENESS_MS:.0f} ms end a grasp: "
            "close other programs, and let this user have real-time priority.",
            figures,
        )
    text = f"{measured_hz:.2f} Hz; blocks late by {figures['late_99_ms']:.2f} ms at most in 99 of 100"
    return CheckResult(check, CheckOutcome.PASS, text, figures)


def check_strain(rest: RawSignals, tool: Tool) -> CheckResult:
    """Check the strain gage with the motor at zero and the jaws open; return the result."""
    check, calibration, volts = "strain gage at rest", tool.calibration, rest.strain_v
    mean_v, sd_v, (least_v, most_v) = float(volts.mean()), float(volts.std()), compute_noise_range_v(tool)
    figures = {"rest_v": mean_v, "noise_v": sd_v}
    found = f"it reads {mean_v:.3f} V and scatters by {sd_v * 1e3:.1f} mV"
    if other := _find_swapped_channel(rest, tool):
        why = f"{found}, and {other} looks like a strain gage: the two are swapped. Exchange their wires or names."
    elif np.abs(volts).max() > SATURATION_SHARE * tool.channels.analog_range_v:
        why = (
            f"{found}, the end of its range: look for a broken wire, an amplifier without power, or an "
            "`analog_range_v` that is too small."
        )
    elif (hum := _compute_mains_share(volts, tool.board.sample_rate_hz)) > MAINS_SHARE and sd_v > most_v:
        why = f"{found}, {hum:.0%} of it mains hum: nothing drives {tool.channels.strain}. Connect the amplifier."
    elif sd_v > most_v:
        why = (
            f"{found}, a sound one by {tool.noise.strain_sd_v * 1e3:.1f} mV: check the cable's screen and "
            "the amplifier."
        )
    elif sd_v < least_v:
        why = f"{found}, which no amplifier does: check that {tool.channels.strain} is the strain gage's channel."
    elif not calibration.is_rest_voltage(mean_v):
        why = (
            f"{found}; the tool file expects {calibration.rest_offset_v:.3f} V within "
            f"{calibration.rest_tolerance_v:.3f} V: open the jaws, balance the bridge, or measure the rest anew with "
            "`graspwatch calibrate tare`."
        )
    else:
        return CheckResult(check, CheckOutcome.PASS, found, figures)
    return CheckResult(check, CheckOutcome.FAIL, why, figures)


def _find_swapped_channel(rest: RawSignals, tool: Tool) -> str | None:
    """Return the other channel that looks like the strain gage, if the strain gage's own does not."""
    channels = tool.channels
    others = {
        f"the motor command read back ({channels.motor_command_readback})": rest.readback_v,
        f"touch sensor 1 ({channels.touch[0]})": rest.touch_v[0],
        f"touch sensor 2 ({channels.touch[1]})": rest.touch_v[1],
    }  # NaN without such a channel, which looks like nothing
    if _looks_like_strain(rest.strain_v, tool):
        return None
    return next((name for name, volts in others.items() if _looks_like_strain(volts, tool)), None)


def _looks_like_strain(volts: np.ndarray, tool: Tool) -> bool:
    least_v, most_v = compute_noise_range_v(tool)
    return tool.calibration.is_rest_voltage(float(volts.mean())) and least_v <= float(volts.std()) <= most_v


def _compute_mains_share(volts: np.ndarray, rate_hz: float) -> float:
    """Return the share of the variance at the frequency of the mains."""
    power = np.abs(np.fft.rfft(volts - volts.mean())) ** 2
    at_hz = np.fft.rfftfreq(len(volts), 1.0 / rate_hz)
    near = np.any([np.abs(at_hz - mains_hz) <= 2.0 for mains_hz in MAINS_HZ], axis=0)
    return float(power[near].sum() / power.sum()) if power.sum() else 0.0


def check_command_at_zero(rest: RawSignals, tool: Tool) -> CheckResult:
    """Check the read-back of the motor command with the motor at zero; return the result."""
    check, most_v = "motor at zero", float(np.abs(rest.readback_v).max())
    if most_v < COMMAND_ON_V:
        return CheckResult(
            check, CheckOutcome.PASS, f"read back within {most_v * 1e3:.0f} mV of zero", {"most_v": most_v}
        )
    channels = tool.channels
    text = (
        f"{channels.motor_command_readback} reads {most_v:.2f} V while the motor is commanded to zero: connect it to "
        f"{channels.motor_command}, or correct `motor_command_readback` under [channels]."
    )
    return CheckResult(check, CheckOutcome.FAIL, text, {"most_v": most_v})


def check_encoder_at_rest(rest: RawSignals) -> CheckResult:
    check, moved_deg = "encoder at rest", float(np.ptp(rest.encoder_deg))
    if moved_deg < MAX_REST_MOTION_DEG:
        return CheckResult(check, CheckOutcome.PASS, f"still within {moved_deg:.2f} degrees", {"moved_deg": moved_deg})
    text = f"it moved by {moved_deg:.1f} degrees: check the screen of its cable, and that nothing turns the motor."
    return CheckResult(check, CheckOutcome.FAIL, text, {"moved_deg": moved_deg})


def check_touch_sensors(rest: RawSignals, tool: Tool) -> CheckResult:
    """Check the touch sensors with the jaws open and empty; return the result."""
    check, threshold_v = "touch sensors at rest", tool.contact.touch_threshold_v
    if not any(tool.channels.touch):
        return CheckResult(check, CheckOutcome.NOT_DONE, "the tool has none")
    levels_v = [float(np.median(volts)) for volts in rest.touch_v]
    figures = {"touch_1_v": levels_v[0], "touch_2_v": levels_v[1]}
    found = f"they read {levels_v[0]:.1f} and {levels_v[1]:.1f} V"
    if min(levels_v) > threshold_v and tool.contact.touch_trusted:
        text = f"{found}, which is contact: empty the jaws, or set `touch_trusted = false` under [contact]."
        return CheckResult(check, CheckOutcome.FAIL, text, figures)
    trust = "" if tool.contact.touch_trusted else "; the tool file does not trust them"
    return CheckResult(check, CheckOutcome.PASS, found + trust, figures)


def check_readback(commands_v: np.ndarray, readback_v: np.ndarray, tool: Tool) -> CheckResult:
    """Check the mean read-back against the command at several levels, V, (n,) each; return the result."""
    check, channels = "motor command read back", tool.channels
    gain, offset_v = (float(value) for value in np.polyfit(commands_v, readback_v, 1))
    figures = {"gain": gain, "offset_v": offset_v}
    if np.abs(readback_v).max() < UNCONNECTED_V:
        why = (
            f"{channels.motor_command_readback} stays at zero: it is not connected to {channels.motor_command}, or the "
            "motor command goes to another output. Connect the two."
        )
    elif abs(gain - 1) > READBACK_GAIN_TOLERANCE or abs(offset_v) > READBACK_OFFSET_TOLERANCE_V:
        why = (
            f"of each volt {gain:.3f} V come back, and {offset_v * 1e3:+.0f} mV at zero: something else drives "
            f"{channels.motor_command_readback}, a divider is in its way, or the output is loaded."
        )
    else:
        text = f"{gain:.4f} V a volt, {offset_v * 1e3:+.1f} mV at zero"
        return CheckResult(check, CheckOutcome.PASS, text, figures)
    return CheckResult(check, CheckOutcome.FAIL, why, figures)


def check_round_trip(samples: int, tool: Tool) -> CheckResult:
    """Check how many samples pass from the last known one at a command's write to its read-back; return the result."""
    check, took_ms = "round trip", 1e3 * samples / tool.board.sample_rate_hz
    figures = {"delay_ms": took_ms}
    if took_ms <= MAX_ROUND_TRIP_MS:
        return CheckResult(
            check, CheckOutcome.PASS, f"a command is read back {took_ms:.0f} ms after its block", figures
        )
    text = (
        f"a command is read back {took_ms:.0f} ms after its block, and more than {MAX_ROUND_TRIP_MS:.0f} ms are "
        "too slow to let "
        "go in time: use a board in this computer, or a faster network."
    )
    return CheckResult(check, CheckOutcome.FAIL, text, figures)


def check_encoder_direction(turned_deg: float, tool: Tool) -> CheckResult:
    """Check by how many degrees the encoder turned while the jaws closed; return the result."""
    check, figures, name = "encoder direction", {"turned_deg": turned_deg}, tool.channels.encoder
    if turned_deg >= MIN_TURN_DEG:
        return CheckResult(check, CheckOutcome.PASS, f"closing turns it by {turned_deg:+.0f} degrees", figures)
    if turned_deg <= -MIN_TURN_DEG:
        text = f"closing turns it by {turned_deg:+.0f} degrees, backwards: exchange A and B of {name}."
    else:
        text = (
            f"closing turns it by {turned_deg:+.1f} degrees only: check the cable of {name}, its name in the file, "
            "that the amplifier is enabled, and that the jaws are free."
        )
    return CheckResult(check, CheckOutcome.FAIL, text, figures)


def check_cable_stretch(strain_v: np.ndarray, encoder_deg: np.ndarray, tool: Tool) -> CheckResult:
    """Check the cable's stretch, degrees per volt, Eq. (3); return the result.

    `strain_v` and `encoder_deg`, (n,) each, are means at several levels of force on shut jaws.
    """
    check, expected = "encoder scale", tool.stretch_deg_per_volt
    if np.ptp(strain_v) < MIN_STRAIN_CHANGE_V or not expected:
        return CheckResult(
            check, CheckOutcome.NOT_DONE, "the strain changed too little with the jaws shut to judge by it"
        )
    slope = float(np.polyfit(strain_v, encoder_deg, 1)[0])
    figures, share = {"deg_per_volt": slope}, slope / expected
    found = f"the cable stretches by {slope:.1f} degrees a volt, the tool file says {expected:.1f}"
    if abs(share - 1) <= SCALE_TOLERANCE:
        return CheckResult(check, CheckOutcome.PASS, found, figures)
    factors = {"half": 0.5, "twice": 2.0, "a quarter of": 0.25, "four times": 4.0}
    guess = next((word for word, factor in factors.items() if abs(share / factor - 1) <= SCALE_TOLERANCE), None)
    if guess:
        text = f"{found}: it counts {guess} the pulses. Correct `encoder_counts_per_rev` or `encoder_gear_ratio`."
    else:
        text = f"{found}: look for a cable that slips, or measure it anew with `graspwatch calibrate stretch`."
    return CheckResult(check, CheckOutcome.FAIL, text, figures)
