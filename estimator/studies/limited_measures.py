"""What the limiter's study measures of a grasp. Forces are the true ones at the jaws, not those that the gage tells."""

from dataclasses import dataclass

import numpy as np

from acquisition.blocks import Flag
from acquisition.limiter import FOLLOW_S
from config.schema import TissueLibrary, Tool
from estimator.studies.limited import LEAD_IN_S, Played, protocol_of
from estimator.studies.limited_cases import HOLD_S, LimitedCase

SETTLED = 0.05  # of what is held in the end
SWING_V = 0.05  # a command that turns by less does not chatter: 0.025 N
PLATEAU_S = 0.2  # the end of the protocol's hold


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a case. `peak` is the highest force as a share of the limit in force.

    The limit in force is margin × threshold in force, as the limiter was told it; one that falls counts `FOLLOW_S`
    later, for no force can follow at once.
    """

    case: LimitedCase
    peak: float  # of the first grasp
    peak_later: float  # of those after it; 0 where there is none
    peak_without: float
    injures: bool  # passes the threshold of the tissue that is held
    injures_without: bool
    held_back: bool
    let_go: bool  # the first grasp
    let_go_later: bool
    touched: bool
    held: float  # at the hold's end, as a share of what is allowed: the limit, or what the command comes to if less
    overshoot: float | None  # over what is held; None where the limit changed meanwhile, or nothing was limited
    settled_s: float | None  # since contact, under the same conditions
    reversals_per_s: float  # of the command at the hold's end
    fault: str  # why the run was ended before its time
    over_fallen_s: float | None  # for how long the force was over a limit that fell below it


def measure(
    case: LimitedCase, tool: Tool, library: TissueLibrary, margin: float, with_it: Played, without_n: np.ndarray
) -> Outcome:
    """What became of a case; `without_n` is its force without the limiter, N, sample by sample."""
    rate_hz = tool.board.sample_rate_hz
    limit_n, force_n, samples = margin * with_it.threshold_n, with_it.force_n, with_it.samples
    counts_n = highest_of_last(limit_n, round(FOLLOW_S * rate_hz))
    peaks, n = force_n / counts_n, min(len(without_n), len(force_n))
    later, let_go = samples["grasp"] > 1, samples["flags"] & Flag.LET_GO > 0
    end = round((LEAD_IN_S + protocol_of(case, tool).waveform.ramp_up_s + HOLD_S) * rate_hz)
    hold = slice(end - round(PLATEAU_S * rate_hz), end)
    held_n = float(np.median(force_n[hold]))
    allowed_n = min(float(np.median(limit_n[hold])), case.strength * case.wanted_n)
    held_back = bool((samples["flags"][hold] & Flag.HELD_BACK).any())
    touched = np.flatnonzero(force_n[:end] > 0)
    own = slice(int(touched[0]), end) if len(touched) else slice(end, end)
    steady = held_back and held_n > 0 and len(touched) > 0 and np.ptp(limit_n[own]) == 0
    return Outcome(
        case=case,
        peak=float(peaks[~later].max()),
        peak_later=float(peaks[later].max(initial=0.0)),
        peak_without=float((without_n[:n] / counts_n[:n]).max()),
        injures=bool(force_n.max() > library.threshold_n(case.tissue)),
        injures_without=bool(without_n.max() > library.threshold_n(case.tissue)),
        held_back=held_back,
        let_go=bool(let_go[~later].any()),
        let_go_later=bool(let_go[later].any()),
        touched=len(touched) > 0,
        held=held_n / allowed_n,
        overshoot=float(force_n[own].max()) / held_n - 1.0 if steady else None,
        settled_s=settling_s(force_n[own], held_n, rate_hz) if steady else None,
        reversals_per_s=reversals(samples["motor_command_v"][hold]) / PLATEAU_S,
        fault=with_it.fault,
        over_fallen_s=over_fallen_s(force_n[:end], limit_n[:end], rate_hz),
    )


def highest_of_last(values: np.ndarray, samples: int) -> np.ndarray:
    """At each sample the highest of it and of so many before it."""
    padded = np.concatenate([np.full(samples, values[0]), values])
    return np.lib.stride_tricks.sliding_window_view(padded, samples + 1).max(axis=1)


def settling_s(force_n: np.ndarray, held_n: float, rate_hz: float) -> float:
    """Time from the first sample until the force stays within `SETTLED` of what is held."""
    off = np.flatnonzero(np.abs(force_n - held_n) > SETTLED * held_n)
    return (int(off[-1]) + 1 if len(off) else 0) / rate_hz


def over_fallen_s(force_n: np.ndarray, limit_n: np.ndarray, rate_hz: float) -> float | None:
    """Time from the first fall of the limit below the force until the force is below it; None where there is none."""
    falls = np.flatnonzero((np.diff(limit_n) < 0) & (force_n[1:] > limit_n[1:])) + 1
    if not len(falls):
        return None
    since = falls[0]
    below = np.flatnonzero(force_n[since:] <= limit_n[since:])
    return (int(below[0]) if len(below) else len(force_n) - since) / rate_hz


def reversals(command_v: np.ndarray) -> int:
    """How often the command turns, swings below `SWING_V` left out."""
    turns, direction, extreme = 0, 0.0, float(command_v[0])
    for value in command_v.tolist():
        swing = value - extreme
        if direction * swing > 0:
            extreme = value
        elif abs(swing) >= SWING_V:
            turns += direction != 0
            direction, extreme = swing, value
    return turns
