"""The grasps of the limiter's study: drawn at random within what is to be held, and beyond it one thing at a time."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from acquisition.limiter import FOLLOW_S
from acquisition.simulation.tissue import EXACT, Deviation
from config.schema import TissueLibrary, Tool

HOLD_S = 0.5
WANTED_N = (0.5, 5.0)
SLOWEST_V_PER_S = 4.0
STRENGTHS = (1 / 1.5, 1.5)
FORCE_SCALES = (0.97, 1.03)
MOST_FRICTION, MOST_BACKLASH_M = 0.05, 100e-6
SPREADS, NOISES = (1.0, 2.0), (1.0, 3.0)
FAST_V_PER_S = 20.0
REPEATED = 2


class Told(StrEnum):
    """What the limiter is told of the tissue."""

    RIGHT = "by the estimator"
    LATE = "late, by 80 to 120 ms"
    DEAD = "until the estimator dies"
    WRONG = "a higher threshold of another tissue"
    WITHDRAWN = "the highest threshold, then the lowest"


@dataclass(frozen=True, slots=True)
class LimitedCase:
    """One grasp, or several alike.

    `strength`, `lags` and `deviation` are the truth, of which the limiter knows nothing. `wanted_n` is what
    the command's peak comes to by the tool's map; `turn_s` after the ramp's start the estimator dies or the threshold
    falls; `spread`, `noise`, `strength` and `lags` are times the library's and the tool file's.
    """

    tissue: str
    seed: int
    told: Told
    told_tissue: str  # whose threshold is told where it is not the estimator that tells
    turn_s: float
    wanted_n: float
    rise_v_per_s: float
    spread: float = 1.0
    noise: float = 1.0
    strength: float = 1.0
    lags: float = 1.0
    deviation: Deviation = EXACT
    grasps: int = 1


# What no limiter can know in time, or at all: told separately.
BEYOND = {
    "tool 1.75 times as strong as its map": {"strength": 1.75},
    "tool twice as strong": {"strength": 2.0},
    "tool 2.5 times as strong": {"strength": 2.5},
    "tool half as strong": {"strength": 0.5},
    "drive and tissue twice as quick": {"lags": 0.5},
    "drive and tissue half as slow again": {"lags": 1.5},
    "gage that reads 10 % short": {"deviation": Deviation(force_scale=0.9)},
}


def draw(library: TissueLibrary, tool: Tool, of_each: int, seed: int) -> list[LimitedCase]:
    """`of_each` grasps of every tissue, over everything at random; ways of being told in turn."""
    names, ways = list(library.tissues), list(Told)
    return [
        _draw(library, tool, names[i % len(names)], ways[i // len(names) % len(ways)], seed, i)
        for i in range(of_each * len(names))
    ]


def beyond(cases: list[LimitedCase], each: int) -> dict[str, list[LimitedCase]]:
    """The first `each` cases with one thing beyond what is to be held: two grasps in a row, on fast ramps."""
    fast = [replace(case, rise_v_per_s=max(case.rise_v_per_s, FAST_V_PER_S), told=Told.WRONG) for case in cases[:each]]
    alike = [replace(case, strength=1.0, grasps=REPEATED) for case in fast]
    return {kind: [replace(case, **changes) for case in alike] for kind, changes in BEYOND.items()}


def _draw(library: TissueLibrary, tool: Tool, tissue: str, told: Told, seed: int, number: int) -> LimitedCase:
    rng = np.random.default_rng([seed, number])
    wanted_n, fastest_v_per_s = float(rng.uniform(*WANTED_N)), tool.limits.max_command_v_per_s
    rise_v_per_s = min(float(np.exp(rng.uniform(np.log(SLOWEST_V_PER_S), np.log(fastest_v_per_s)))), fastest_v_per_s)
    ramp_s = float(tool.command_to_force.command(wanted_n)) / rise_v_per_s
    return LimitedCase(
        tissue,
        seed * 1_000_000 + number,
        told,
        _told_tissue(library, tissue, told, rng),
        turn_s=float(rng.uniform(0.0, ramp_s + HOLD_S - 3 * FOLLOW_S)),
        wanted_n=wanted_n,
        rise_v_per_s=rise_v_per_s,
        spread=float(rng.choice(SPREADS)),
        noise=float(rng.choice(NOISES)),
        strength=float(np.exp(rng.uniform(*np.log(STRENGTHS)))),
        deviation=Deviation(
            force_scale=float(rng.uniform(*FORCE_SCALES)),
            friction_share=float(rng.uniform(0.0, MOST_FRICTION)),
            backlash_m=float(rng.uniform(0.0, MOST_BACKLASH_M)),
        ),
    )


def _told_tissue(library: TissueLibrary, tissue: str, told: Told, rng: np.random.Generator) -> str:
    """One with a higher threshold; the highest where there is none, or where it is to fall."""
    by_threshold = sorted(library.tissues, key=library.threshold_n)
    higher = [name for name in by_threshold if library.threshold_n(name) > library.threshold_n(tissue)]
    return by_threshold[-1] if told is Told.WITHDRAWN or not higher else str(rng.choice(higher))
