"""Compiled functions on the caller's arrays: one step of one extended Kalman filter, and all filters of the bank.

State: [x, x', log alpha, log beta, log d, log m, offset, drift, strain noise]. Logarithms keep parameters positive.
`offset` is the error of the displacement's zero at contact, m. `drift` is the force by which the tissue has left its
curve, N. `strain noise` is the strain gage's error of the present sample, V. It enters the force (input) and the
displacement (measurement) together, Eqs. (1) and (3), so it is a state to keep their correlation right. The force
changes linearly from one sample to the next.
"""

import math
from typing import NamedTuple

import numpy as np

from acquisition.compilation import compiled
from estimator.constants import (
    DRIFT_FLOOR_N,
    EXPONENT_LIMIT,
    MAX_INFLATION,
    MAX_LOG_DEVIATION,
    MIN_RISE_N,
    MIN_RISE_SHARE,
    NIS_DIVERGED,
    NIS_INFLATION_THRESHOLD,
    NIS_MEMORY,
    RISE_MEAN_SAMPLES,
    RISE_SPAN_SAMPLES,
    SURPRISE_MIN_SAMPLES,
)
from estimator.tissue_model import elastic_force, step_matrices, tangent_stiffness

STATE_COUNT = 9
X, V, LOG_ALPHA, LOG_BETA, LOG_DAMPING, LOG_MASS, OFFSET, DRIFT, STRAIN_NOISE = range(STATE_COUNT)
PARAMETERS = slice(LOG_ALPHA, LOG_DAMPING + 1)
PARAMETERS_AND_MASS = slice(LOG_ALPHA, LOG_MASS + 1)
# columns of a sample as the filters take it
FORCE, DISPLACEMENT, NEWTON_PER_VOLT, METRE_PER_VOLT, ELAPSED_S, IS_RISING = range(6)
LOG_LIKELIHOOD, NIS_SUM, NIS_RECENT, INFLATION = range(4)  # columns of a filter's fit statistics


class FilterNoise(NamedTuple):
    """A filter's noise model of sensors and tissue."""

    strain_var: float  # V², enters force and displacement by newton_per_volt and metre_per_volt
    force_var: float  # N², further noise of the force in a step
    displacement_var: float  # m², further noise of a displacement
    walk_alpha: float  # variances of the log parameters' random walk, per sample
    walk_beta: float
    walk_damping: float
    dynamic_share: float  # share by which damping and inertial force may be wrong, sample by sample
    drift_rate: float  # share of the force squared, 1/s: random walk of the drift
    learns_held: float  # 0: parameters are learned only while the force rises


@compiled
def process_sample(
    mean: np.ndarray,
    cov: np.ndarray,
    fit: np.ndarray,
    about: np.ndarray,
    before: np.ndarray,
    sample: np.ndarray,
    noise: FilterNoise,
    step: np.ndarray,
    rows: np.ndarray,
    gain: np.ndarray,
) -> None:
    """Predict the state from the sample `before` to `sample` and correct it, in place.

    Args:
        mean, cov: state, (9,) and (9, 9).
        fit: log-likelihood, sum and running mean of the normalized innovations squared, and total inflation of the
            covariance, (4,).
        about: log alpha, beta, d and m about which the model is linearized, (4,).
        before, sample: force N, displacement m, change of each per volt of strain noise, time since the previous
            sample s, and whether the force rises, (6,).
        step, rows, gain: scratch, (2, 4), (2, 9) and (9,).
    """
    predict(mean, cov, about, before, sample, noise, step, rows)
    learns = noise.learns_held + sample[IS_RISING] > 0.0
    innovation, variance, widened = update(mean, cov, sample[DISPLACEMENT], sample[METRE_PER_VOLT], noise, learns, gain)
    nis = innovation * innovation / variance
    fit[LOG_LIKELIHOOD] -= 0.5 * (nis + math.log(2.0 * math.pi * variance))
    fit[NIS_SUM] += nis
    fit[NIS_RECENT] = NIS_MEMORY * fit[NIS_RECENT] + (1.0 - NIS_MEMORY) * nis
    fit[INFLATION] *= widened


@compiled
def predict(
    mean: np.ndarray,
    cov: np.ndarray,
    about: np.ndarray,
    before: np.ndarray,
    sample: np.ndarray,
    noise: FilterNoise,
    step: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Time update over one sample, Eqs. (14), (15), (19), (20) with a stable step; see `process_sample`."""
    alpha, beta, damping, mass = math.exp(about[0]), math.exp(about[1]), math.exp(about[2]), math.exp(about[3])
    x, v = mean[X], mean[V]
    elastic = elastic_force(alpha, beta, x)
    stiffness = tangent_stiffness(alpha, beta, x)
    step_matrices(mass, stiffness, damping, sample[ELAPSED_S], step)
    by_alpha, by_beta, by_damping = -elastic, -stiffness * x, -damping * v
    held = before[FORCE] - before[NEWTON_PER_VOLT] * mean[STRAIN_NOISE] - mean[DRIFT] - elastic + stiffness * x
    rise = sample[FORCE] - before[FORCE] + before[NEWTON_PER_VOLT] * mean[STRAIN_NOISE]
    inertial = held - stiffness * x - damping * v
    by_mass = -inertial
    held += (
        by_alpha * (mean[LOG_ALPHA] - about[0])
        + by_beta * (mean[LOG_BETA] - about[1])
        + by_damping * (mean[LOG_DAMPING] - about[2])
        + by_mass * (mean[LOG_MASS] - about[3])
    )
    damped = damping * v
    force_var = noise.force_var + noise.dynamic_share * noise.dynamic_share * (damped * damped + inertial * inertial)
    mean[X] = step[0, 0] * x + step[0, 1] * v + step[0, 2] * held + step[0, 3] * rise
    mean[V] = step[1, 0] * x + step[1, 1] * v + step[1, 2] * held + step[1, 3] * rise
    mean[STRAIN_NOISE] = 0.0

    for r in range(2):  # rows of Phi P for x and v; the previous sample's noise fades over the step
        g = step[r, 2]
        by_strain = -before[NEWTON_PER_VOLT] * (g - step[r, 3])
        for j in range(STATE_COUNT):
            rows[r, j] = (
                step[r, 0] * cov[X, j]
                + step[r, 1] * cov[V, j]
                + by_strain * cov[STRAIN_NOISE, j]
                - g * cov[DRIFT, j]
                + g
                * (
                    by_alpha * cov[LOG_ALPHA, j]
                    + by_beta * cov[LOG_BETA, j]
                    + by_damping * cov[LOG_DAMPING, j]
                    + by_mass * cov[LOG_MASS, j]
                )
            )
    for q in range(2):
        g = step[q, 2]
        by_strain = -before[NEWTON_PER_VOLT] * (g - step[q, 3])
        for r in range(q, 2):
            value = (
                step[q, 0] * rows[r, X]
                + step[q, 1] * rows[r, V]
                + by_strain * rows[r, STRAIN_NOISE]
                - g * rows[r, DRIFT]
                + g
                * (
                    by_alpha * rows[r, LOG_ALPHA]
                    + by_beta * rows[r, LOG_BETA]
                    + by_damping * rows[r, LOG_DAMPING]
                    + by_mass * rows[r, LOG_MASS]
                )
            )
            fresh = sample[NEWTON_PER_VOLT] * sample[NEWTON_PER_VOLT] * step[r, 3] * step[q, 3] * noise.strain_var
            value += fresh + step[r, 2] * g * force_var
            cov[r, q] = value
            cov[q, r] = value
    for r in range(2):
        for j in range(LOG_ALPHA, DRIFT + 1):
            cov[r, j] = rows[r, j]
            cov[j, r] = rows[r, j]
    for j in range(LOG_ALPHA, STATE_COUNT):
        cov[STRAIN_NOISE, j] = 0.0
        cov[j, STRAIN_NOISE] = 0.0
    cov[STRAIN_NOISE, STRAIN_NOISE] = noise.strain_var
    for r in range(2):
        cov[r, STRAIN_NOISE] = -sample[NEWTON_PER_VOLT] * step[r, 3] * noise.strain_var
        cov[STRAIN_NOISE, r] = cov[r, STRAIN_NOISE]
    cov[LOG_ALPHA, LOG_ALPHA] += noise.walk_alpha
    cov[LOG_BETA, LOG_BETA] += noise.walk_beta
    cov[LOG_DAMPING, LOG_DAMPING] += noise.walk_damping
    cov[DRIFT, DRIFT] += (
        noise.drift_rate * sample[ELAPSED_S] * (sample[FORCE] * sample[FORCE] + DRIFT_FLOOR_N * DRIFT_FLOOR_N)
    )


@compiled
def update(
    mean: np.ndarray,
    cov: np.ndarray,
    displacement_m: float,
    metre_per_volt: float,
    noise: FilterNoise,
    learns: bool,
    gain: np.ndarray,
) -> tuple[float, float, float]:
    """Measurement update for y = x + offset + (dx/dV) strain + noise, Eqs. (16) to (18).

    If `learns` is False, parameters and mass keep mean and covariance, and all else is corrected (Schmidt filter).
    Returns the innovation, m, its variance, m², and the factor by which the covariance was inflated first.
    """
    innovation = displacement_m - mean[X] - mean[OFFSET] - metre_per_volt * mean[STRAIN_NOISE]
    variance = project_covariance(cov, metre_per_volt, gain) + noise.displacement_var
    believed, widened = variance, 1.0
    surprise = innovation * innovation / variance / NIS_INFLATION_THRESHOLD
    if learns and surprise > 1.0:
        widened = min(surprise, MAX_INFLATION)
        inflate_covariance(cov, widened)
        believed = project_covariance(cov, metre_per_volt, gain) + noise.displacement_var
    for j in range(STATE_COUNT):
        if learns or j < LOG_ALPHA or j > LOG_MASS:
            mean[j] += gain[j] * innovation / believed
    for j in range(STATE_COUNT):
        share = gain[j] / believed
        for q in range(j + 1):
            if not learns and q >= LOG_ALPHA and j <= LOG_MASS:
                continue
            value = cov[j, q] - share * gain[q]
            cov[j, q] = value
            cov[q, j] = value
    return innovation, variance, widened


@compiled
def project_covariance(cov: np.ndarray, metre_per_volt: float, gain: np.ndarray) -> float:
    """Write P Hᵀ into `gain` (9,) and return H P Hᵀ, m²."""
    for j in range(STATE_COUNT):
        gain[j] = cov[j, X] + cov[j, OFFSET] + metre_per_volt * cov[j, STRAIN_NOISE]
    return gain[X] + gain[OFFSET] + metre_per_volt * gain[STRAIN_NOISE]


@compiled
def inflate_covariance(cov: np.ndarray, factor: float) -> None:
    """Multiply the covariance of all states but the strain noise by `factor`, in place."""
    root = math.sqrt(factor)
    for j in range(STATE_COUNT):
        for q in range(STATE_COUNT):
            cov[j, q] *= (1.0 if j == STRAIN_NOISE else root) * (1.0 if q == STRAIN_NOISE else root)


@compiled
def is_healthy(mean: np.ndarray, cov: np.ndarray, guess: np.ndarray) -> bool:
    """Return False if a filter has diverged.

    A value is not finite, a variance is negative, a parameter is far from its guess, or beta x would overflow.
    """
    for j in range(STATE_COUNT):
        if not (math.isfinite(mean[j]) and cov[j, j] >= 0.0):
            return False
    for j in range(3):
        if abs(mean[LOG_ALPHA + j] - guess[j]) > MAX_LOG_DEVIATION:
            return False
    return math.exp(mean[LOG_BETA]) * mean[X] < EXPONENT_LIMIT


@compiled
def repeat_pass(
    mean: np.ndarray,
    cov: np.ndarray,
    fit: np.ndarray,
    about: np.ndarray,
    guess: np.ndarray,
    samples: np.ndarray,
    noise: FilterNoise,
    step: np.ndarray,
    rows: np.ndarray,
    gain: np.ndarray,
) -> bool:
    """Process all `samples` of the grasp again, linearized about `about`; return whether the filter stayed healthy.

    `mean` and `cov` hold the state at the first sample. It is one Gauss-Newton step in the parameters.
    """
    fit[:] = 1.0
    fit[LOG_LIKELIHOOD], fit[NIS_SUM] = 0.0, 0.0
    for i in range(1, len(samples)):
        process_sample(mean, cov, fit, about, samples[i - 1], samples[i], noise, step, rows, gain)
        if not is_healthy(mean, cov, guess):
            return False
    return True


@compiled
def is_force_rising(history: np.ndarray, taken: int, force_n: float) -> bool:
    """Return whether the force has risen by more than its noise over the last samples, or the grasp just began."""
    if taken <= RISE_SPAN_SAMPLES + RISE_MEAN_SAMPLES:
        return True
    change = force_n
    for i in range(1, RISE_MEAN_SAMPLES):
        change += history[(taken - i) % len(history), FORCE]
    for i in range(RISE_SPAN_SAMPLES, RISE_SPAN_SAMPLES + RISE_MEAN_SAMPLES):
        change -= history[(taken - i) % len(history), FORCE]
    return change / RISE_MEAN_SAMPLES > max(MIN_RISE_N, MIN_RISE_SHARE * force_n)


@compiled
def advance_bank(
    samples: np.ndarray,
    history: np.ndarray,
    taken: np.ndarray,
    noises: tuple[FilterNoise, ...],
    second_pass_at: np.ndarray,
    guess: np.ndarray,
    first_mean: np.ndarray,
    first_cov: np.ndarray,
    mean: np.ndarray,
    cov: np.ndarray,
    fit: np.ndarray,
    valid: np.ndarray,
    surprise: np.ndarray,
    shown_mean: np.ndarray,
    shown_var: np.ndarray,
) -> None:
    """Advance all K filters over `samples`, (n, 5): for each of `noises` one filter for each of M tissues.

    Args:
        history: ring buffer of the grasp's samples so far, (capacity, 6).
        taken: number of samples so far, (1,); the last one is in row (taken - 1) modulo the capacity.
        second_pass_at: sample counts at which the filters of each noise process the grasp again, (noises, m), at most
            the capacity.
        guess, first_mean, first_cov: log parameters (K, 3) and states (K, 9), (K, 9, 9) at the grasp's start, for all
            tissues with the first noise, then all tissues with the next.
        mean, cov, fit, valid: the filters' present state, changed in place.
        surprise: highest running misfit so far of the best filter with the last noise, (1,), changed in place.
        shown_mean, shown_var: each tissue's likelier filter after each sample, (n, M, 9); NaN where all have diverged.
    """
    step, rows, gain = np.empty((2, 4)), np.empty((2, STATE_COUNT)), np.empty(STATE_COUNT)
    again_mean, again_cov, again_fit = (
        np.empty(STATE_COUNT),
        np.empty((STATE_COUNT, STATE_COUNT)),
        np.empty(INFLATION + 1),
    )
    sample = np.empty(IS_RISING + 1)
    tissues = len(mean) // len(noises)
    for i in range(len(samples)):
        before = history[(taken[0] - 1) % len(history)].copy()
        sample[:IS_RISING] = samples[i]
        sample[IS_RISING] = is_force_rising(history, taken[0], sample[FORCE])
        history[taken[0] % len(history)] = sample
        taken[0] += 1
        for k in range(len(mean)):
            if not valid[k]:
                continue
            noise = noises[k // tissues]
            process_sample(
                mean[k], cov[k], fit[k], mean[k, PARAMETERS_AND_MASS], before, sample, noise, step, rows, gain
            )
            valid[k] = is_healthy(mean[k], cov[k], guess[k])
            if valid[k] and np.any(second_pass_at[k // tissues] == taken[0]):
                again_mean[:], again_cov[:] = first_mean[k], first_cov[k]
                if repeat_pass(
                    again_mean,
                    again_cov,
                    again_fit,
                    mean[k, PARAMETERS_AND_MASS],
                    guess[k],
                    history[: taken[0]],
                    noise,
                    step,
                    rows,
                    gain,
                ):
                    mean[k], cov[k], fit[k] = again_mean, again_cov, again_fit
        if taken[0] > SURPRISE_MIN_SAMPLES:
            best = find_likeliest_filter(len(mean) - tissues, len(mean), fit, valid)
            surprise[0] = max(surprise[0], fit[best, NIS_RECENT] if best >= 0 else NIS_DIVERGED)
        for tissue in range(tissues):
            best = -1
            for k in range(tissue, len(mean), tissues):
                if is_tracking(k, fit, valid) and (best < 0 or fit[k, LOG_LIKELIHOOD] > fit[best, LOG_LIKELIHOOD]):
                    best = k
            for j in range(STATE_COUNT):
                shown_mean[i, tissue, j] = mean[best, j] if best >= 0 else np.nan
                shown_var[i, tissue, j] = cov[best, j, j] if best >= 0 else np.nan


@compiled
def find_likeliest_filter(first: int, until: int, fit: np.ndarray, valid: np.ndarray) -> int:
    """Return the valid filter from `first` to before `until` with the highest likelihood; -1 if there is none."""
    best = -1
    for k in range(first, until):
        if valid[k] and (best < 0 or fit[k, LOG_LIKELIHOOD] > fit[best, LOG_LIKELIHOOD]):
            best = k
    return best


@compiled
def is_tracking(k: int, fit: np.ndarray, valid: np.ndarray) -> bool:
    """Return whether filter k has neither diverged nor lost the data at present."""
    return valid[k] and fit[k, NIS_RECENT] < NIS_DIVERGED
