"""Functions that measure a case of the limiter's study by the true forces at the jaws, not the strain gage's."""

from dataclasses import dataclass

import numpy as np

from acquisition.safety.force_limiter import THRESHOLD_SETTLING_S
from acquisition.sample_block import SampleFlag
from config.schema import TissueLibrary, Tool
from estimator.studies.limiter_cases import HOLD_S, LimitedCase
from estimator.studies.limiter_simulation import LEAD_IN_S, LimitedRun, build_waveform

SETTLING_TOLERANCE = 0.05  # share of the force held in the end
MIN_SWING_V = 0.05  # a smaller swing of the command, 0.025 N, is no chatter
EVALUATED_HOLD_S = 0.2  # evaluated end of the protocol's hold


@dataclass(frozen=True, slots=True)
class LimiterOutcome:
    """Measures of one case. Peaks are the highest force as a share of the limit.

    The limit is margin × the threshold that the limiter received. A lower limit counts `THRESHOLD_SETTLING_S` later,
    because no force can follow at once.
    """

    case: LimitedCase
    peak_share: float  # of the first grasp
    later_peak_share: float  # of the later grasps; 0 without any
    unlimited_peak_share: float
    exceeds_threshold: bool  # passes the threshold of the tissue held
    unlimited_exceeds_threshold: bool
    limited: bool
    released: bool  # the first grasp
    released_later: bool
    made_contact: bool
    allowed_force_share: float  # force at the hold's end over the lower of limit and commanded force
    overshoot: float | None  # over the held force; None if the limit changed or the force was not limited
    settling_s: float | None  # since contact; None as for the overshoot
    reversals_per_s: float  # of the command at the hold's end
    fault: str  # why the run ended early
    over_lowered_limit_s: float | None  # time that the force needed to fall below a lowered limit


def measure_outcome(
    case: LimitedCase,
    tool: Tool,
    library: TissueLibrary,
    margin: float,
    limited_run: LimitedRun,
    unlimited_force_n: np.ndarray,
) -> LimiterOutcome:
    """Return the measures of a case; `unlimited_force_n` is its force without the limiter, N, sample by sample."""
    rate_hz = tool.board.sample_rate_hz
    limit_n, force_n, samples = margin * limited_run.threshold_n, limited_run.force_n, limited_run.samples
    counts_n = compute_rolling_max(limit_n, round(THRESHOLD_SETTLING_S * rate_hz))
    peaks, n = force_n / counts_n, min(len(unlimited_force_n), len(force_n))
    later, let_go = samples["grasp"] > 1, samples["flags"] & SampleFlag.RELEASED > 0
    end = round((LEAD_IN_S + build_waveform(case, tool).ramp_up_s + HOLD_S) * rate_hz)
    hold = slice(end - round(EVALUATED_HOLD_S * rate_hz), end)
    held_n = float(np.median(force_n[hold]))
    allowed_n = min(float(np.median(limit_n[hold])), case.gain_ratio * case.requested_force_n)
    held_back = bool((samples["flags"][hold] & SampleFlag.LIMITED).any())
    touched = np.flatnonzero(force_n[:end] > 0)
    own = slice(int(touched[0]), end) if len(touched) else slice(end, end)
    steady = held_back and held_n > 0 and len(touched) > 0 and np.ptp(limit_n[own]) == 0
    return LimiterOutcome(
        case=case,
        peak_share=float(peaks[~later].max()),
        later_peak_share=float(peaks[later].max(initial=0.0)),
        unlimited_peak_share=float((unlimited_force_n[:n] / counts_n[:n]).max()),
        exceeds_threshold=bool(force_n.max() > library.threshold_n(case.tissue)),
        unlimited_exceeds_threshold=bool(unlimited_force_n.max() > library.threshold_n(case.tissue)),
        limited=held_back,
        released=bool(let_go[~later].any()),
        released_later=bool(let_go[later].any()),
        made_contact=len(touched) > 0,
        allowed_force_share=held_n / allowed_n,
        overshoot=float(force_n[own].max()) / held_n - 1.0 if steady else None,
        settling_s=settling_s(force_n[own], held_n, rate_hz) if steady else None,
        reversals_per_s=count_reversals(samples["motor_command_v"][hold]) / EVALUATED_HOLD_S,
        fault=limited_run.fault,
        over_lowered_limit_s=compute_time_over_lowered_limit_s(force_n[:end], limit_n[:end], rate_hz),
    )


def compute_rolling_max(values: np.ndarray, samples: int) -> np.ndarray:
    """Return at each sample the maximum of it and of the `samples` before it."""
    padded = np.concatenate([np.full(samples, values[0]), values])
    return np.lib.stride_tricks.sliding_window_view(padded, samples + 1).max(axis=1)


def settling_s(force_n: np.ndarray, held_n: float, rate_hz: float) -> float:
    """Return the time from the first sample until the force stays within `SETTLING_TOLERANCE` of the held force."""
    off = np.flatnonzero(np.abs(force_n - held_n) > SETTLING_TOLERANCE * held_n)
    return (int(off[-1]) + 1 if len(off) else 0) / rate_hz


def compute_time_over_lowered_limit_s(force_n: np.ndarray, limit_n: np.ndarray, rate_hz: float) -> float | None:
    """Return how long the force stays over the limit after the limit first falls below it, s; None if it never does."""
    falls = np.flatnonzero((np.diff(limit_n) < 0) & (force_n[1:] > limit_n[1:])) + 1
    if not len(falls):
        return None
    since = falls[0]
    below = np.flatnonzero(force_n[since:] <= limit_n[since:])
    return (int(below[0]) if len(below) else len(force_n) - since) / rate_hz


def count_reversals(command_v: np.ndarray) -> int:
    """Count the reversals of the command, without swings below `MIN_SWING_V`."""
    turns, direction, extreme = 0, 0.0, float(command_v[0])
    for value in command_v.tolist():
        swing = value - extreme
        if direction * swing > 0:
            extreme = value
        elif abs(swing) >= MIN_SWING_V:
            turns += direction != 0
            direction, extreme = swing, value
    return turns
