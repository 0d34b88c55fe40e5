"""`graspwatch study limiter`: is the force held under the limit in force, and are grasps still held by it?"""

from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go

from acquisition.blocks import Flag
from acquisition.limiter import FOLLOW_S
from acquisition.simulation.tissue import Deviation
from config.schema import TissueLibrary, Tool
from estimator.studies.course import Bench, set_up
from estimator.studies.limited import HOLD_S, LEAD_IN_S, LimitedCase, Played, Told, play, protocol_of
from estimator.studies.report import PALETTE, Figure, Study, Table
from estimator.studies.runner import Progress, run_cases

MOST_WANTED_N, LEAST_WANTED_N = 5.0, 0.5
SLOWEST_RAMP_V_PER_S = 2.0
STRENGTHS, SCALES = (1 / 1.5, 1.5), (0.97, 1.03)
FRICTION, BACKLASH_M = 0.05, 100e-6
BOARD_V = 10.0  # what the board can give: commands up to 5 N by the map need 8.9 V
MOST_OVER_SHARE, MOST_OVER, LEAST_HELD = 0.1, 5.0, 60.0  # %
SETTLED = 0.05  # of what is held in the end
SWING_V = 0.05  # a command that turns by less does not chatter: 0.025 N
PLATEAU_S = 0.2  # before the protocol ends the hold


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a case. Forces are the true ones at the jaws, shares are of the limit in force."""

    case: LimitedCase
    peak: float
    peak_n: float
    peak_without: float
    peak_without_n: float
    injures: bool  # over the true tissue's threshold
    injures_without: bool
    is_limited: bool
    touched: bool
    let_go: bool
    held: float  # share of what is allowed: of the limit, or of what the protocol comes to where that is less
    settled_s: float | None  # since contact
    reversals_per_s: float
    over_fallen_s: float | None  # for how long the force was over a limit that fell
    differs_v: float  # largest difference of the command from that without the limiter


def limiter(bench: Bench, grasps: int, seed: int, progress: Progress, jobs: int | None = None) -> Study:
    lab = _lab(bench)
    cases = draw(lab.library, lab.tool, 4 * grasps, seed)
    outcomes = run_cases(_outcome, [(bench, case) for case in cases], progress, jobs)
    raise NotImplementedError(outcomes)


def draw(library: TissueLibrary, tool: Tool, grasps: int, seed: int) -> list[LimitedCase]:
    """Grasps over everything at random, tissues and ways of being told in turn."""
    names, ways = list(library.tissues), list(Told)
    return [_draw(library, tool, names[i % len(names)], ways[i // len(names) % len(ways)], seed, i) for i in range(grasps)]


def _draw(library: TissueLibrary, tool: Tool, tissue: str, told: Told, seed: int, i: int) -> LimitedCase:
    rng = np.random.default_rng([seed, i])
    wanted_n = float(rng.uniform(LEAST_WANTED_N, MOST_WANTED_N))
    rise_v_per_s = float(np.exp(rng.uniform(np.log(SLOWEST_RAMP_V_PER_S), np.log(tool.limits.max_command_v_per_s))))
    peak_v = float(tool.command_to_force.command(wanted_n))
    return LimitedCase(
        tissue, seed * 1_000_000 + i, told, _told_tissue(library, tissue, told, rng),
        turn_s=float(rng.uniform(0.0, peak_v / rise_v_per_s + HOLD_S - 2 * FOLLOW_S)),
        wanted_n=wanted_n, rise_v_per_s=min(rise_v_per_s, tool.limits.max_command_v_per_s),
        spread=float(rng.choice([1.0, 2.0])), noise=float(rng.choice([1.0, 3.0])),
        strength=float(np.exp(rng.uniform(*np.log(STRENGTHS)))),
        deviation=Deviation(
            force_scale=float(rng.uniform(*SCALES)), friction_share=float(rng.uniform(0.0, FRICTION)),
            backlash_m=float(rng.uniform(0.0, BACKLASH_M)),
        ),
    )  # fmt: skip


def _told_tissue(library: TissueLibrary, tissue: str, told: Told, rng: np.random.Generator) -> str:
    """Whose threshold is told wrongly: one of those that are higher, where there is one."""
    by_threshold = sorted(library.tissues, key=library.threshold_n)
    higher = [name for name in by_threshold if library.threshold_n(name) > library.threshold_n(tissue)]
    return by_threshold[-1] if told is Told.WITHDRAWN or not higher else str(rng.choice(higher))


def _lab(bench: Bench):
    lab = set_up(bench)
    limits = lab.tool.limits.model_copy(update={"max_command_v": BOARD_V})
    return replace(lab, tool=lab.tool.model_copy(update={"limits": limits}))


def _outcome(job: tuple[Bench, LimitedCase]) -> Outcome:
    bench, case = job
    lab = _lab(bench)
    with_it = play(case, lab.tool, lab.library, lab.settings, limited=True)
    without = play(replace(case, told=Told.WRONG), lab.tool, lab.library, lab.settings, limited=False)
    return measure(case, lab.tool, lab.library, lab.settings.limiter.margin, with_it, without)


def measure(
    case: LimitedCase, tool: Tool, library: TissueLibrary, margin: float, with_it: Played, without: Played
) -> Outcome:
    """Compare both plays of a case."""
    rate_hz = tool.board.sample_rate_hz
    limit_n = margin * with_it.threshold_n
    grace_n = _most_of_last(limit_n, round(FOLLOW_S * rate_hz))
    n = min(len(with_it.force_n), len(without.force_n))
    threshold_n = library.threshold_n(case.tissue)
    force_n, flags = with_it.force_n, with_it.samples["flags"]
    ramp_s = protocol_of(case, tool).waveform.ramp_up_s
    end = round((LEAD_IN_S + ramp_s + HOLD_S) * rate_hz)
    plateau = slice(end - round(PLATEAU_S * rate_hz), end)
    contact = np.flatnonzero(force_n > 0)
    allowed_n = min(float(np.median(limit_n[plateau])), case.strength * case.wanted_n)
    held_n = float(np.median(force_n[plateau]))
    command_v = with_it.samples["motor_command_v"]
    return Outcome(
        case,
        float((force_n / grace_n).max()), float(force_n.max()),
        float((without.force_n[:n] / grace_n[:n]).max()), float(without.force_n.max()),
        bool(force_n.max() > threshold_n), bool(without.force_n.max() > threshold_n),
        bool((flags & Flag.HELD_BACK).any()), bool(len(contact)), with_it.let_go > 0,
        held_n / allowed_n,
        _settled_s(force_n[contact[0] : end], held_n, rate_hz) if len(contact) and held_n > 0 else None,
        reversals(command_v[plateau]) / PLATEAU_S,
        _over_fallen_s(force_n, limit_n, rate_hz),
        float(np.abs(command_v[:n] - without.samples["motor_command_v"][:n]).max()),
    )  # fmt: skip


def _most_of_last(values: np.ndarray, samples: int) -> np.ndarray:
    padded = np.concatenate([np.full(samples, values[0]), values])
    return np.lib.stride_tricks.sliding_window_view(padded, samples + 1).max(axis=1)


def _settled_s(force_n: np.ndarray, held_n: float, rate_hz: float) -> float:
    """Time since contact after which the force stays where it is held."""
    off = np.flatnonzero(np.abs(force_n - held_n) > SETTLED * held_n)
    return (int(off[-1]) + 1 if len(off) else 0) / rate_hz


def _over_fallen_s(force_n: np.ndarray, limit_n: np.ndarray, rate_hz: float) -> float | None:
    """For how long the force was over a limit after it fell; None where it never fell onto the force."""
    falls = np.flatnonzero((np.diff(limit_n) < 0) & (force_n[1:] > limit_n[1:])) + 1
    if not len(falls):
        return None
    over = np.flatnonzero(force_n[falls[0] :] > limit_n[falls[0] :])
    gaps = np.flatnonzero(np.diff(over) > 1)
    return float((over[gaps[0]] if len(gaps) else over[-1]) + 1) / rate_hz


def reversals(command_v: np.ndarray) -> int:
    """How often the command turns, swings below SWING_V left out."""
    count, direction, extreme = 0, 0, float(command_v[0])
    for value in command_v.tolist():
        if direction >= 0 and value > extreme or direction <= 0 and value < extreme:
            if direction == 0 and abs(value - extreme) < SWING_V:
                continue
            direction = direction or (1 if value > extreme else -1)
            extreme = value
        elif abs(value - extreme) >= SWING_V:
            count, direction, extreme = count + 1, -direction, value
    return count
