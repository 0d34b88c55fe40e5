"""Functions for the cases of the limiter's study: random within the stated bounds, or one property beyond them."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from acquisition.safety.force_limiter import THRESHOLD_SETTLING_S
from acquisition.simulation.tissue import NO_DEVIATION, ModelDeviation
from config.schema import TissueLibrary, Tool

HOLD_S = 0.5
REQUESTED_FORCE_RANGE_N = (0.5, 5.0)
MIN_RAMP_V_PER_S = 4.0
GAIN_RATIO_RANGE = (1 / 1.5, 1.5)
FORCE_SCALE_RANGE = (0.97, 1.03)
MAX_FRICTION_SHARE, MAX_BACKLASH_M = 0.05, 100e-6
SPREADS, NOISES = (1.0, 2.0), (1.0, 3.0)
FAST_RAMP_V_PER_S = 20.0
GRASPS_PER_CASE = 2


class ThresholdScenario(StrEnum):
    """Threshold that the limiter receives."""

    RIGHT = "by the estimator"
    LATE = "late, by 80 to 120 ms"
    DEAD = "until the estimator dies"
    WRONG = "a higher threshold of another tissue"
    WITHDRAWN = "the highest threshold, then the lowest"


@dataclass(frozen=True, slots=True)
class LimitedCase:
    """One grasp, or several equal ones.

    `gain_ratio`, `lag_factor` and `deviation` are the truth, which the limiter does not know. `requested_force_n` is
    the force of the command's peak by the tool's map. At `change_s` after the ramp's start the estimator dies or the
    threshold falls. Factors and the gain ratio multiply the values of the library and the tool file.
    """

    tissue: str
    seed: int
    scenario: ThresholdScenario
    reported_tissue: str  # tissue whose threshold the limiter receives in scenarios without an estimator
    change_s: float
    requested_force_n: float
    ramp_v_per_s: float
    spread_factor: float = 1.0
    noise_factor: float = 1.0
    gain_ratio: float = 1.0
    lag_factor: float = 1.0
    deviation: ModelDeviation = NO_DEVIATION
    grasps: int = 1


# Properties that no limiter can know in time, or at all; reported separately.
OUT_OF_BOUNDS = {
    "tool 1.75 times as strong as its map": {"gain_ratio": 1.75},
    "tool twice as strong": {"gain_ratio": 2.0},
    "tool 2.5 times as strong": {"gain_ratio": 2.5},
    "tool half as strong": {"gain_ratio": 0.5},
    "drive and tissue twice as quick": {"lag_factor": 0.5},
    "drive and tissue half as slow again": {"lag_factor": 1.5},
    "gage that reads 10 % short": {"deviation": ModelDeviation(force_scale=0.9)},
}


def draw_cases(library: TissueLibrary, tool: Tool, grasps_per_tissue: int, seed: int) -> list[LimitedCase]:
    """Draw `grasps_per_tissue` random cases of every tissue, with the scenarios in turn."""
    names, ways = list(library.tissues), list(ThresholdScenario)
    return [
        _draw_case(library, tool, names[i % len(names)], ways[i // len(names) % len(ways)], seed, i)
        for i in range(grasps_per_tissue * len(names))
    ]


def build_out_of_bounds_cases(cases: list[LimitedCase], each: int) -> dict[str, list[LimitedCase]]:
    """Return the first `each` cases with one property out of bounds: two grasps in a row, on fast ramps."""
    fast = [
        replace(case, ramp_v_per_s=max(case.ramp_v_per_s, FAST_RAMP_V_PER_S), scenario=ThresholdScenario.WRONG)
        for case in cases[:each]
    ]
    alike = [replace(case, gain_ratio=1.0, grasps=GRASPS_PER_CASE) for case in fast]
    return {kind: [replace(case, **changes) for case in alike] for kind, changes in OUT_OF_BOUNDS.items()}


def _draw_case(
    library: TissueLibrary, tool: Tool, tissue: str, told: ThresholdScenario, seed: int, number: int
) -> LimitedCase:
    rng = np.random.default_rng([seed, number])
    wanted_n, fastest_v_per_s = float(rng.uniform(*REQUESTED_FORCE_RANGE_N)), tool.limits.max_command_v_per_s
    rise_v_per_s = min(float(np.exp(rng.uniform(np.log(MIN_RAMP_V_PER_S), np.log(fastest_v_per_s)))), fastest_v_per_s)
    ramp_s = float(tool.command_to_force.to_command_v(wanted_n)) / rise_v_per_s
    return LimitedCase(
        tissue,
        seed * 1_000_000 + number,
        told,
        _choose_reported_tissue(library, tissue, told, rng),
        change_s=float(rng.uniform(0.0, ramp_s + HOLD_S - 3 * THRESHOLD_SETTLING_S)),
        requested_force_n=wanted_n,
        ramp_v_per_s=rise_v_per_s,
        spread_factor=float(rng.choice(SPREADS)),
        noise_factor=float(rng.choice(NOISES)),
        gain_ratio=float(np.exp(rng.uniform(*np.log(GAIN_RATIO_RANGE)))),
        deviation=ModelDeviation(
            force_scale=float(rng.uniform(*FORCE_SCALE_RANGE)),
            friction_share=float(rng.uniform(0.0, MAX_FRICTION_SHARE)),
            backlash_m=float(rng.uniform(0.0, MAX_BACKLASH_M)),
        ),
    )


def _choose_reported_tissue(
    library: TissueLibrary, tissue: str, told: ThresholdScenario, rng: np.random.Generator
) -> str:
    """Return a tissue with a higher threshold; the one with the highest if there is none, or if it will fall."""
    by_threshold = sorted(library.tissues, key=library.threshold_n)
    higher = [name for name in by_threshold if library.threshold_n(name) > library.threshold_n(tissue)]
    return by_threshold[-1] if told is ThresholdScenario.WITHDRAWN or not higher else str(rng.choice(higher))
