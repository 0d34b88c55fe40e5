"""An unscented filter (Julier and Uhlmann) in place of each strict one: same states, noise, start and evidence.

No lenient filters, and so no evidence from surprise.
"""

import math

import numpy as np

from config.schema import Identification, TissueLibrary, Tool
from estimator.bank import Bank, Priors, strict_and_lenient
from estimator.compiling import compiled
from estimator.constants import NIS_MEMORY
from estimator.evidence import Evidence
from estimator.filter import (
    BY_FORCE,
    ELAPSED,
    FORCE,
    LOG_ALPHA,
    LOG_BETA,
    LOG_DAMPING,
    LOG_LIKELIHOOD,
    LOG_MASS,
    NIS_RECENT,
    NIS_SUM,
    STATES,
    STRAIN,
    WIDENED,
    V,
    X,
    is_sound,
    update,
)
from estimator.identifier import BankIdentifier
from estimator.model import elastic_force, step_matrices, tangent_stiffness

SCALING = 1.0  # lambda: the central point keeps a tenth of the weight, and all weights stay positive


class UnscentedBank(Bank):
    """The strict filters, unscented. No second passes: there is no linearisation to renew."""

    def advance(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        state = self.state
        shape = (len(samples), len(self._guess), STATES)
        mean, variance = np.empty(shape), np.empty(shape)
        for i, sample in enumerate(samples):
            _take(self._history[0], sample, self._noises[0], self._guess, state.mean, state.cov, state.fit, state.valid)
            self._history[0, : len(sample)] = sample
            state.taken[0] += 1
            mean[i], variance[i] = state.mean, np.diagonal(state.cov, axis1=1, axis2=2)
        return mean, variance


def unscented_identifier(tool: Tool, library: TissueLibrary, settings: Identification) -> BankIdentifier:
    """Unscented filters for a library's tissues on a tool."""
    bank = UnscentedBank(Priors.of(library), strict_and_lenient(tool)[:1])
    return BankIdentifier(bank, Evidence(bank, library, settings), 1.0 / tool.board.sample_rate_hz)


@compiled
def _take(before, sample, noise, guess, mean, cov, fit, valid):
    points, step, gain = np.empty((2 * STATES + 1, STATES)), np.empty((2, 4)), np.empty(STATES)
    for k in range(len(mean)):
        if not valid[k]:
            continue
        _predict(mean[k], cov[k], before, sample, noise, points, step)
        innovation, variance, widened = update(mean[k], cov[k], sample[1], sample[3], noise, True, gain)
        nis = innovation * innovation / variance
        fit[k, LOG_LIKELIHOOD] -= 0.5 * (nis + math.log(2.0 * math.pi * variance))
        fit[k, NIS_SUM] += nis
        fit[k, WIDENED] *= widened
        fit[k, NIS_RECENT] = NIS_MEMORY * fit[k, NIS_RECENT] + (1.0 - NIS_MEMORY) * nis
        valid[k] = is_sound(mean[k], cov[k], guess[k])


@compiled
def _predict(mean, cov, before, sample, noise, points, step):
    """Move 19 sigma points through the step, each linearised at itself, and take their mean and covariance."""
    weight = 0.5 / (STATES + SCALING)
    root = _root(cov)
    for j in range(STATES):
        spread = math.sqrt(STATES + SCALING) * root[:, j]
        points[j], points[STATES + j] = mean + spread, mean - spread
    points[-1] = mean
    for point in points:
        alpha, beta = math.exp(point[LOG_ALPHA]), math.exp(point[LOG_BETA])
        x, v = point[X], point[V]
        stiffness = tangent_stiffness(alpha, beta, x)
        step_matrices(math.exp(point[LOG_MASS]), stiffness, math.exp(point[LOG_DAMPING]), sample[ELAPSED], step)
        noise_n = before[BY_FORCE] * point[STRAIN]
        held = before[FORCE] - noise_n - elastic_force(alpha, beta, x) + stiffness * x
        rise = sample[FORCE] - before[FORCE] + noise_n
        point[X] = step[0, 0] * x + step[0, 1] * v + step[0, 2] * held + step[0, 3] * rise
        point[V] = step[1, 0] * x + step[1, 1] * v + step[1, 2] * held + step[1, 3] * rise
        point[STRAIN] = 0.0
    mean[:] = SCALING / (STATES + SCALING) * points[-1]
    for point in points[:-1]:
        mean += weight * point
    cov[:] = SCALING / (STATES + SCALING) * np.outer(points[-1] - mean, points[-1] - mean)
    for point in points[:-1]:
        cov += weight * np.outer(point - mean, point - mean)
    # `step` is still that of the central point
    for r in range(2):
        for q in range(2):
            fresh = sample[BY_FORCE] * sample[BY_FORCE] * step[r, 3] * step[q, 3] * noise.strain_var
            cov[r, q] += fresh + step[r, 2] * step[q, 2] * noise.force_var
        cov[r, STRAIN] = cov[STRAIN, r] = -sample[BY_FORCE] * step[r, 3] * noise.strain_var
    cov[STRAIN, STRAIN] = noise.strain_var
    cov[LOG_ALPHA, LOG_ALPHA] += noise.walk_alpha
    cov[LOG_BETA, LOG_BETA] += noise.walk_beta
    cov[LOG_DAMPING, LOG_DAMPING] += noise.walk_damping


@compiled
def _root(cov):
    """Lower Cholesky factor of a positive semi-definite matrix: a state that is known for certain has a zero column."""
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
