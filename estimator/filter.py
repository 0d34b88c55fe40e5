"""One extended Kalman filter on one grasp, compiled.

State: [x, x', log alpha, log beta, log d, log m, offset, drift, strain noise]. Logarithms keep parameters positive.
`offset` is what the displacement at contact is wrong by; `drift` is the force by which tissue has left its curve, N.
`strain noise` is the strain gage's error of the present sample, V: it enters the force (input) and the displacement
(measurement) together, Eqs. (1) and (3), so it has to be a state for their correlation to be right. The force goes
straight from one sample to the next.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.compiling import compiled
from estimator.constants import (
    DRIFT_FLOOR_N,
    EXPONENT_LIMIT,
    LOG_RANGE,
    NIS_DIVERGED,
    NIS_MEMORY,
    NIS_SURPRISING,
    RISING_LEAST_N,
    RISING_MEAN,
    RISING_SHARE,
    RISING_SPAN,
    SURPRISE_FROM,
    WIDENING_MOST,
)
from estimator.model import elastic_force, step_matrices, tangent_stiffness

STATES = 9
X, V, LOG_ALPHA, LOG_BETA, LOG_DAMPING, LOG_MASS, OFFSET, DRIFT, STRAIN = range(STATES)
PARAMETERS = slice(LOG_ALPHA, LOG_DAMPING + 1)
ABOUT = slice(LOG_ALPHA, LOG_MASS + 1)
FORCE, DISPLACEMENT, BY_FORCE, BY_DISPLACEMENT, ELAPSED, RISING = range(6)  # columns of a sample as the filters take it
LOG_LIKELIHOOD, NIS_SUM, NIS_RECENT, WIDENED = range(4)  # columns of a filter's fit


class Noise(NamedTuple):
    """How far a filter trusts sensors and model."""

    strain_var: float  # V², enters force and displacement by newton_per_volt and metre_per_volt
    force_var: float  # N², of the force in a step beside that
    displacement_var: float  # m², of a displacement beside that
    walk_alpha: float  # variances of the log parameters' walk, a sample
    walk_beta: float
    walk_damping: float
    dynamic_share: float  # by which damping and inertial force may be wrong, sample by sample
    drift_rate: float  # of the force squared, 1/s: random walk of the force by which the tissue leaves its curve
    learns_held: float  # 0: parameters are learned only while the force rises


@compiled
def take(mean, cov, fit, about, before, sample, noise, step, rows, gain):
    """Predict from the sample `before` to `sample` and correct by it, in place.

    Args:
        mean, cov: state, (9,) and (9, 9).
        fit: log-likelihood, sum and running mean of the normalised innovations squared, and by how much the covariance
            has been widened in all, (4,).
        about: log parameters about which the model is linearised, (4,).
        before, sample: force N, displacement m, what a volt of strain noise does to each, and the time since the sample
            before, s; and whether the force rises; (6,).
        step, rows, gain: scratch, (2, 4), (2, 9) and (9,).
    """
    predict(mean, cov, about, before, sample, noise, step, rows)
    learns = noise.learns_held + sample[RISING] > 0.0
    innovation, variance, widened = update(
        mean, cov, sample[DISPLACEMENT], sample[BY_DISPLACEMENT], noise, learns, gain
    )
    nis = innovation * innovation / variance
    fit[LOG_LIKELIHOOD] -= 0.5 * (nis + math.log(2.0 * math.pi * variance))
    fit[NIS_SUM] += nis
    fit[NIS_RECENT] = NIS_MEMORY * fit[NIS_RECENT] + (1.0 - NIS_MEMORY) * nis
    fit[WIDENED] *= widened


@compiled
def predict(mean, cov, about, before, sample, noise, step, rows):
    """Time update over one sample, Eqs. (14), (15), (19), (20) with a stable step; see `take`."""
    alpha, beta, damping, mass = math.exp(about[0]), math.exp(about[1]), math.exp(about[2]), math.exp(about[3])
    x, v = mean[X], mean[V]
    elastic = elastic_force(alpha, beta, x)
    stiffness = tangent_stiffness(alpha, beta, x)
    step_matrices(mass, stiffness, damping, sample[ELAPSED], step)
    by_alpha, by_beta, by_damping = -elastic, -stiffness * x, -damping * v
    held = before[FORCE] - before[BY_FORCE] * mean[STRAIN] - mean[DRIFT] - elastic + stiffness * x
    rise = sample[FORCE] - before[FORCE] + before[BY_FORCE] * mean[STRAIN]
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
    mean[STRAIN] = 0.0

    for r in range(2):  # rows of Phi P for x and v; the noise of the sample before fades over the step
        g = step[r, 2]
        by_strain = -before[BY_FORCE] * (g - step[r, 3])
        for j in range(STATES):
            rows[r, j] = (
                step[r, 0] * cov[X, j]
                + step[r, 1] * cov[V, j]
                + by_strain * cov[STRAIN, j]
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
        by_strain = -before[BY_FORCE] * (g - step[q, 3])
        for r in range(q, 2):
            value = (
                step[q, 0] * rows[r, X]
                + step[q, 1] * rows[r, V]
                + by_strain * rows[r, STRAIN]
                - g * rows[r, DRIFT]
                + g
                * (
                    by_alpha * rows[r, LOG_ALPHA]
                    + by_beta * rows[r, LOG_BETA]
                    + by_damping * rows[r, LOG_DAMPING]
                    + by_mass * rows[r, LOG_MASS]
                )
            )
            fresh = sample[BY_FORCE] * sample[BY_FORCE] * step[r, 3] * step[q, 3] * noise.strain_var
            value += fresh + step[r, 2] * g * force_var
            cov[r, q] = value
            cov[q, r] = value
    for r in range(2):
        for j in range(LOG_ALPHA, DRIFT + 1):
            cov[r, j] = rows[r, j]
            cov[j, r] = rows[r, j]
    for j in range(LOG_ALPHA, STATES):
        cov[STRAIN, j] = 0.0
        cov[j, STRAIN] = 0.0
    cov[STRAIN, STRAIN] = noise.strain_var
    for r in range(2):
        cov[r, STRAIN] = -sample[BY_FORCE] * step[r, 3] * noise.strain_var
        cov[STRAIN, r] = cov[r, STRAIN]
    cov[LOG_ALPHA, LOG_ALPHA] += noise.walk_alpha
    cov[LOG_BETA, LOG_BETA] += noise.walk_beta
    cov[LOG_DAMPING, LOG_DAMPING] += noise.walk_damping
    cov[DRIFT, DRIFT] += (
        noise.drift_rate * sample[ELAPSED] * (sample[FORCE] * sample[FORCE] + DRIFT_FLOOR_N * DRIFT_FLOOR_N)
    )


@compiled
def update(mean, cov, displacement_m, metre_per_volt, noise, learns, gain):
    """Measurement update for y = x + offset + (dx/dV) strain + noise, Eqs. (16) to (18).

    Where it does not learn, parameters and their covariance stay as they are, and all the rest is corrected (Schmidt).
    Returns the innovation, m, its variance, m², and by how much the covariance was widened before.
    """
    innovation = displacement_m - mean[X] - mean[OFFSET] - metre_per_volt * mean[STRAIN]
    variance = project(cov, metre_per_volt, gain) + noise.displacement_var
    believed, widened = variance, 1.0
    surprise = innovation * innovation / variance / NIS_SURPRISING
    if learns and surprise > 1.0:
        widened = min(surprise, WIDENING_MOST)
        widen(cov, widened)
        believed = project(cov, metre_per_volt, gain) + noise.displacement_var
    for j in range(STATES):
        if learns or j < LOG_ALPHA or j > LOG_MASS:
            mean[j] += gain[j] * innovation / believed
    for j in range(STATES):
        share = gain[j] / believed
        for q in range(j + 1):
            if not learns and q >= LOG_ALPHA and j <= LOG_MASS:
                continue
            value = cov[j, q] - share * gain[q]
            cov[j, q] = value
            cov[q, j] = value
    return innovation, variance, widened


@compiled
def project(cov, metre_per_volt, gain):
    """P Hᵀ into `gain` (9,); returns H P Hᵀ, m²."""
    for j in range(STATES):
        gain[j] = cov[j, X] + cov[j, OFFSET] + metre_per_volt * cov[j, STRAIN]
    return gain[X] + gain[OFFSET] + metre_per_volt * gain[STRAIN]


@compiled
def widen(cov, factor):
    """Be less sure of everything but the strain noise by `factor`, in place."""
    root = math.sqrt(factor)
    for j in range(STATES):
        for q in range(STATES):
            cov[j, q] *= (1.0 if j == STRAIN else root) * (1.0 if q == STRAIN else root)


@compiled
def is_sound(mean, cov, guess):
    """False once a filter has diverged: not finite, a variance negative, or a parameter run away from its guess."""
    for j in range(STATES):
        if not (math.isfinite(mean[j]) and cov[j, j] >= 0.0):
            return False
    for j in range(3):
        if abs(mean[LOG_ALPHA + j] - guess[j]) > LOG_RANGE:
            return False
    return math.exp(mean[LOG_BETA]) * mean[X] < EXPONENT_LIMIT


@compiled
def pass_again(mean, cov, fit, about, guess, samples, noise, step, rows, gain):
    """Go over all `samples` from the grasp's start, linearised about `about`; returns whether the filter stayed sound.

    `mean` and `cov` hold the state at the first sample; one step of Gauss and Newton's method in the parameters.
    """
    fit[:] = 1.0
    fit[LOG_LIKELIHOOD], fit[NIS_SUM] = 0.0, 0.0
    for i in range(1, len(samples)):
        take(mean, cov, fit, about, samples[i - 1], samples[i], noise, step, rows, gain)
        if not is_sound(mean, cov, guess):
            return False
    return True


@compiled
def rises(history, taken, force_n):
    """Whether the force has risen over the last samples by more than its noise, or the grasp has only begun."""
    if taken <= RISING_SPAN + RISING_MEAN:
        return True
    change = force_n
    for i in range(1, RISING_MEAN):
        change += history[(taken - i) % len(history), FORCE]
    for i in range(RISING_SPAN, RISING_SPAN + RISING_MEAN):
        change -= history[(taken - i) % len(history), FORCE]
    return change / RISING_MEAN > max(RISING_LEAST_N, RISING_SHARE * force_n)


@compiled
def advance_bank(
    samples,
    history,
    taken,
    noises,
    second_pass_at,
    guess,
    first_mean,
    first_cov,
    mean,
    cov,
    fit,
    valid,
    surprise,
    shown_mean,
    shown_var,
):
    """Advance all filters over `samples`, (n, 5): M tissues times as many filters each as there are `noises`.

    Args:
        history: the grasp's samples so far, (capacity, 6); its first row is the one that the grasp began with.
        taken: how many came so far, (1,); the last of them is in row (taken - 1) modulo the capacity.
        second_pass_at: counts at which the filters go over the grasp again, (m,), at most the capacity.
        guess, first_mean, first_cov: log parameters (K, 3) and states (K, 9), (K, 9, 9) that the grasp began with;
            K filters: all tissues with the first noise, then all with the next.
        mean, cov, fit, valid: the filters' present state, changed in place.
        surprise: how badly even the best of the last kind of filter has ever fitted lately in this grasp, (1,).
        shown_mean, shown_var: each tissue's likelier filter after each sample, (n, M, 9); NaN where all have diverged.
    """
    step, rows, gain = np.empty((2, 4)), np.empty((2, STATES)), np.empty(STATES)
    again_mean, again_cov, again_fit = np.empty(STATES), np.empty((STATES, STATES)), np.empty(WIDENED + 1)
    sample = np.empty(RISING + 1)
    tissues = len(mean) // len(noises)
    for i in range(len(samples)):
        before = history[(taken[0] - 1) % len(history)].copy()
        sample[:RISING] = samples[i]
        sample[RISING] = rises(history, taken[0], sample[FORCE])
        history[taken[0] % len(history)] = sample
        taken[0] += 1
        passes = np.any(second_pass_at == taken[0])
        for k in range(len(mean)):
            if not valid[k]:
                continue
            noise = noises[k // tissues]
            take(mean[k], cov[k], fit[k], mean[k, ABOUT], before, sample, noise, step, rows, gain)
            valid[k] = is_sound(mean[k], cov[k], guess[k])
            if passes and valid[k]:
                again_mean[:], again_cov[:] = first_mean[k], first_cov[k]
                if pass_again(
                    again_mean,
                    again_cov,
                    again_fit,
                    mean[k, ABOUT],
                    guess[k],
                    history[: taken[0]],
                    noise,
                    step,
                    rows,
                    gain,
                ):
                    mean[k], cov[k], fit[k] = again_mean, again_cov, again_fit
        if taken[0] > SURPRISE_FROM:
            best = likeliest(len(mean) - tissues, len(mean), fit, valid)
            surprise[0] = max(surprise[0], fit[best, NIS_RECENT] if best >= 0 else NIS_DIVERGED)
        for tissue in range(tissues):
            best = -1
            for k in range(tissue, len(mean), tissues):
                if is_followed(k, fit, valid) and (best < 0 or fit[k, LOG_LIKELIHOOD] > fit[best, LOG_LIKELIHOOD]):
                    best = k
            for j in range(STATES):
                shown_mean[i, tissue, j] = mean[best, j] if best >= 0 else np.nan
                shown_var[i, tissue, j] = cov[best, j, j] if best >= 0 else np.nan


@compiled
def likeliest(first, until, fit, valid):
    """The filter from `first` to before `until` that the data make likeliest; -1 where none is valid."""
    best = -1
    for k in range(first, until):
        if valid[k] and (best < 0 or fit[k, LOG_LIKELIHOOD] > fit[best, LOG_LIKELIHOOD]):
            best = k
    return best


@compiled
def is_followed(k, fit, valid):
    """Whether filter k has neither diverged nor lost the data just now."""
    return valid[k] and fit[k, NIS_RECENT] < NIS_DIVERGED
