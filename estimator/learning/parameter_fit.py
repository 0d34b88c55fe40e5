"""Functions that fit alpha, beta and d of a recorded grasp to its whole loading at once.

Real tissue differs too much from the filters' equation to follow it sample by sample from a wide prior. So the
parameters for the filters' priors come from a least-squares fit of Eq. (7) without inertia. The drag of cable and
drive, which is large and nearly constant while the jaws travel, becomes part of d.
"""

import math

import numpy as np

from acquisition.sample_block import SampleFlag
from config.schema import TissueLibrary, Tool
from estimator.constants import FILLED_JAWS_MARGIN_M
from estimator.loading.constants import (
    FIT_EFFECTIVE_POINTS,
    FIT_FORCE_SHARE,
    FIT_POINTS,
    FIT_PRIOR_LOG_SD,
    MEAN_SAMPLES,
    MIN_FIT_SAMPLES,
)

INVALID, CONTACT_SENSED = SampleFlag.INVALID.value, SampleFlag.CONTACT_SENSED.value
MAX_ITERATIONS = 60
EXPONENT_LIMIT = 30.0


def compute_initial_guess(base: TissueLibrary) -> np.ndarray:
    """Return the mean log alpha, log beta, log d of a library, (3,): the start of the search for every tissue."""
    rows = [(t.alpha_n, t.beta_per_m, t.damping_kg_per_s) for t in base.tissues.values()]
    return np.log(rows).mean(axis=0)


def fit_parameters(samples: np.ndarray, rate_hz: float, guess: np.ndarray) -> np.ndarray:
    """Return log alpha, log beta, log d, (3,), of a grasp from contact to jaw closure; NaN if it has no loading.

    Args:
        samples: samples of one grasp, dtype SAMPLE.
        rate_hz: sample rate.
        guess: prior mean of the logarithms, (3,), with the SD `FIT_PRIOR_LOG_SD`.
    """
    loading = _extract_loading(samples, rate_hz)
    if loading is None:
        return np.full(3, np.nan)
    force_n, x_m, velocity = loading
    sd_n = FIT_FORCE_SHARE * float(force_n.max())
    at, damping, cost = guess.copy(), 1e-2, math.inf
    prior = 1.0 / np.array(FIT_PRIOR_LOG_SD)
    residual, slope = _compute_residuals(at, force_n, x_m, velocity, sd_n, guess, prior)
    cost = float(residual @ residual)
    for _ in range(MAX_ITERATIONS):
        normal = slope.T @ slope
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -slope.T @ residual)
        tried = at + np.clip(step, -1.0, 1.0)
        new_residual, new_slope = _compute_residuals(tried, force_n, x_m, velocity, sd_n, guess, prior)
        new_cost = float(new_residual @ new_residual)
        if new_cost < cost:
            done = cost - new_cost < 1e-9 * cost
            at, residual, slope, cost, damping = tried, new_residual, new_slope, new_cost, damping / 5
            if done:
                break
        else:
            damping *= 5
    return at


def _extract_loading(samples: np.ndarray, rate_hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return force N, displacement m and velocity m/s from contact to jaw closure or the highest force, each (n,)."""
    contacts = samples["contact_tick"][samples["contact_tick"] >= 0]
    if not len(contacts):
        return None
    walls = samples["wall_tick"][samples["wall_tick"] >= 0]
    end = walls[-1] if len(walls) else samples["tick"][int(np.nanargmax(np.nan_to_num(samples["jaw_force_n"])))]
    own = samples[(samples["tick"] >= contacts[-1]) & (samples["tick"] < end) & ((samples["flags"] & INVALID) == 0)]
    if len(own) < MIN_FIT_SAMPLES:
        return None
    mean = np.full(MEAN_SAMPLES, 1.0 / MEAN_SAMPLES)
    force_n, x_m = (np.convolve(own[name], mean, "valid") for name in ("jaw_force_n", "jaw_displacement_m"))
    velocity = np.convolve(np.gradient(x_m) * rate_hz, mean, "same")
    some = np.unique(np.linspace(0, len(force_n) - 1, FIT_POINTS).astype(int))
    return force_n[some] - min(float(force_n[0]), 0.0), x_m[some] - x_m[0], velocity[some]


def _compute_residuals(
    at: np.ndarray,
    force_n: np.ndarray,
    x_m: np.ndarray,
    velocity: np.ndarray,
    sd_n: float,
    guess: np.ndarray,
    prior: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals of force and prior in standard deviations, (n + 3,), and their Jacobian, (n + 3, 3)."""
    alpha, beta, d = np.exp(at)
    exponent = np.minimum(beta * x_m, EXPONENT_LIMIT)
    elastic, drag = alpha * np.expm1(exponent), d * velocity
    slope = np.column_stack([elastic, alpha * np.exp(exponent) * exponent, drag]) / sd_n
    residual = (elastic + drag - force_n) / sd_n
    weight = math.sqrt(FIT_EFFECTIVE_POINTS / len(force_n))  # errors of neighboring points are correlated
    return np.append(weight * residual, prior * (at - guess)), np.vstack([weight * slope, np.diag(prior)])


def measure_thickness_m(samples: np.ndarray, tool: Tool) -> float | None:
    """Return the gap between the jaws at first contact, m; None without sensed contact, or if tissue fills the jaws."""
    opening_m = tool.opening_m
    sensed = np.flatnonzero(samples["flags"] & CONTACT_SENSED)
    if opening_m is None or not len(sensed):
        return None
    at = int(np.searchsorted(samples["tick"], samples["contact_tick"][sensed[-1]]))
    travel_m = float(samples["jaw_displacement_m"][min(at, len(samples) - 1)])
    return opening_m - travel_m if FILLED_JAWS_MARGIN_M <= travel_m < opening_m else None
