"""Unscented Kalman filters (Julier and Uhlmann) in place of the strict ones: same states, noise, start and evidence.

There are no lenient filters, and so no evidence from surprise.
"""

import math

import numpy as np

from acquisition.compilation import compiled
from config.schema import IdentificationSettings, TissueLibrary, Tool
from estimator.baselines.identifier import BankIdentifier
from estimator.constants import NIS_MEMORY
from estimator.evidence import BankEvidence
from estimator.filter_bank import FilterBank, TissuePriors, build_filter_tunings
from estimator.kalman_filter import (
    ELAPSED_S,
    FORCE,
    INFLATION,
    LOG_ALPHA,
    LOG_BETA,
    LOG_DAMPING,
    LOG_LIKELIHOOD,
    LOG_MASS,
    NEWTON_PER_VOLT,
    NIS_RECENT,
    NIS_SUM,
    STATE_COUNT,
    STRAIN_NOISE,
    FilterNoise,
    V,
    X,
    is_healthy,
    update,
)
from estimator.tissue_model import elastic_force, step_matrices, tangent_stiffness

UNSCENTED_LAMBDA = 1.0  # the central point has a tenth of the weight, and all weights are positive


class UnscentedFilterBank(FilterBank):
    """Bank of unscented strict filters. It has no second passes, because there is no linearization to repeat."""

    def advance(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        state = self.state
        shape = (len(samples), len(self._guess), STATE_COUNT)
        mean, variance = np.empty(shape), np.empty(shape)
        for i, sample in enumerate(samples):
            _process_sample(
                self._history[0],
                sample,
                self._noises[0],
                self._guess,
                state.mean,
                state.cov,
                state.fit_statistics,
                state.valid,
            )
            self._history[0, : len(sample)] = sample
            state.samples_taken[0] += 1
            mean[i], variance[i] = state.mean, np.diagonal(state.cov, axis1=1, axis2=2)
        return mean, variance


def build_unscented_identifier(tool: Tool, library: TissueLibrary, settings: IdentificationSettings) -> BankIdentifier:
    """Create unscented filters for a library's tissues on a tool."""
    bank = UnscentedFilterBank(TissuePriors.from_library(library), build_filter_tunings(tool)[:1])
    return BankIdentifier(bank, BankEvidence(bank, library, settings), 1.0 / tool.board.sample_rate_hz)


@compiled
def _process_sample(
    before: np.ndarray,
    sample: np.ndarray,
    noise: FilterNoise,
    guess: np.ndarray,
    mean: np.ndarray,
    cov: np.ndarray,
    fit: np.ndarray,
    valid: np.ndarray,
) -> None:
    points, step, gain = np.empty((2 * STATE_COUNT + 1, STATE_COUNT)), np.empty((2, 4)), np.empty(STATE_COUNT)
    for k in range(len(mean)):
        if not valid[k]:
            continue
        _predict(mean[k], cov[k], before, sample, noise, points, step)
        innovation, variance, widened = update(mean[k], cov[k], sample[1], sample[3], noise, True, gain)
        nis = innovation * innovation / variance
        fit[k, LOG_LIKELIHOOD] -= 0.5 * (nis + math.log(2.0 * math.pi * variance))
        fit[k, NIS_SUM] += nis
        fit[k, INFLATION] *= widened
        fit[k, NIS_RECENT] = NIS_MEMORY * fit[k, NIS_RECENT] + (1.0 - NIS_MEMORY) * nis
        valid[k] = is_healthy(mean[k], cov[k], guess[k])


@compiled
def _predict(
    mean: np.ndarray,
    cov: np.ndarray,
    before: np.ndarray,
    sample: np.ndarray,
    noise: FilterNoise,
    points: np.ndarray,
    step: np.ndarray,
) -> None:
    """Move 19 sigma points through the step, each linearized at itself, and compute their mean and covariance."""
    weight = 0.5 / (STATE_COUNT + UNSCENTED_LAMBDA)
    root = _compute_cholesky_factor(cov)
    for j in range(STATE_COUNT):
        spread = math.sqrt(STATE_COUNT + UNSCENTED_LAMBDA) * root[:, j]
        points[j], points[STATE_COUNT + j] = mean + spread, mean - spread
    points[-1] = mean
    for point in points:
        alpha, beta = math.exp(point[LOG_ALPHA]), math.exp(point[LOG_BETA])
        x, v = point[X], point[V]
        stiffness = tangent_stiffness(alpha, beta, x)
        step_matrices(math.exp(point[LOG_MASS]), stiffness, math.exp(point[LOG_DAMPING]), sample[ELAPSED_S], step)
        noise_n = before[NEWTON_PER_VOLT] * point[STRAIN_NOISE]
        held = before[FORCE] - noise_n - elastic_force(alpha, beta, x) + stiffness * x
        rise = sample[FORCE] - before[FORCE] + noise_n
        point[X] = step[0, 0] * x + step[0, 1] * v + step[0, 2] * held + step[0, 3] * rise
        point[V] = step[1, 0] * x + step[1, 1] * v + step[1, 2] * held + step[1, 3] * rise
        point[STRAIN_NOISE] = 0.0
    mean[:] = UNSCENTED_LAMBDA / (STATE_COUNT + UNSCENTED_LAMBDA) * points[-1]
    for point in points[:-1]:
        mean += weight * point
    cov[:] = UNSCENTED_LAMBDA / (STATE_COUNT + UNSCENTED_LAMBDA) * np.outer(points[-1] - mean, points[-1] - mean)
    for point in points[:-1]:
        cov += weight * np.outer(point - mean, point - mean)
    # `step` still holds the step of the central point
    for r in range(2):
        for q in range(2):
            fresh = sample[NEWTON_PER_VOLT] * sample[NEWTON_PER_VOLT] * step[r, 3] * step[q, 3] * noise.strain_var
            cov[r, q] += fresh + step[r, 2] * step[q, 2] * noise.force_var
        cov[r, STRAIN_NOISE] = cov[STRAIN_NOISE, r] = -sample[NEWTON_PER_VOLT] * step[r, 3] * noise.strain_var
    cov[STRAIN_NOISE, STRAIN_NOISE] = noise.strain_var
    cov[LOG_ALPHA, LOG_ALPHA] += noise.walk_alpha
    cov[LOG_BETA, LOG_BETA] += noise.walk_beta
    cov[LOG_DAMPING, LOG_DAMPING] += noise.walk_damping


@compiled
def _compute_cholesky_factor(cov: np.ndarray) -> np.ndarray:
    """Return the lower Cholesky factor of a positive semi-definite matrix; a state without variance gives zeros."""
    n = len(cov)
    root = np.zeros((n, n))
    for j in range(n):
        pivot = cov[j, j]
        for q in range(j):
            pivot -= root[j, q] ** 2
        if pivot <= 1e-14 * cov[j, j]:
            continue
        root[j, j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            value = cov[i, j]
            for q in range(j):
                value -= root[i, q] * root[j, q]
            root[i, j] = value / root[j, j]
    return root
