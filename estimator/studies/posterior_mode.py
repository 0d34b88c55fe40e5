"""The function maximize_posterior: the most probable parameters of a grasp by all of its samples, and its problem.

An extended filter that learns sample by sample changes the damping because of noise in the velocity. Here the
parameters stay fixed while a filter estimates displacement, velocity, offset and strain noise. Its innovations, their
variances and slopes give Gauss-Newton steps for the parameters.
"""

from dataclasses import dataclass

import numpy as np

from acquisition.compilation import compiled
from estimator.filter_bank import FilterBank
from estimator.kalman_filter import (
    DISPLACEMENT,
    LOG_ALPHA,
    LOG_MASS,
    METRE_PER_VOLT,
    OFFSET,
    PARAMETERS_AND_MASS,
    STATE_COUNT,
    STRAIN_NOISE,
    FilterNoise,
    X,
    predict,
    project_covariance,
)

ITERATIONS = 8
DIFFERENCE_STEP = 1e-4  # step of a log parameter for slopes
MAX_STEP = 1.0  # largest change of a log parameter in one iteration
STEP_TOLERANCE = 1e-4


@dataclass(frozen=True, slots=True)
class PosteriorProblem:
    """A grasp's samples, (n, 5) as in `FilterBank.advance`, and a filter's state at its start."""

    mean: np.ndarray  # (9,)
    cov: np.ndarray  # (9, 9)
    samples: np.ndarray
    noise: FilterNoise

    @classmethod
    def from_bank(cls, bank: FilterBank, k: int, samples: np.ndarray) -> "PosteriorProblem":
        """Create the problem for filter `k` of a started bank; `samples`, (n, 5), begin with the first in contact."""
        mean, cov, noise = bank.initial_state(k)
        return cls(mean, cov, samples, noise)

    @property
    def prior_var(self) -> np.ndarray:
        """Prior variance of log alpha, log beta, log d, log m, (4,); 0 for a known parameter."""
        return np.diag(self.cov)[PARAMETERS_AND_MASS].copy()

    def innovations(self, log_parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return innovations, m, and their variances, m², of a filter with these parameters, (4,), fixed."""
        mean, cov = self.mean.copy(), self.cov.copy()
        mean[PARAMETERS_AND_MASS] = log_parameters
        cov[PARAMETERS_AND_MASS, :], cov[:, PARAMETERS_AND_MASS] = 0.0, 0.0
        return compute_innovations(mean, cov, self.samples, self.noise)

    def compute_gradient_and_information(self, log_parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the negative log posterior's gradient, (4,), and Fisher information, (4, 4); 0 for known ones."""
        found, variance = self.innovations(log_parameters)
        slopes, log_slopes = np.zeros((4, len(found))), np.zeros((4, len(found)))
        prior = self.prior_var
        for j in np.flatnonzero(prior > 0):
            shift = np.zeros(4)
            shift[j] = DIFFERENCE_STEP
            (up, up_var), (down, down_var) = (self.innovations(log_parameters + s) for s in (shift, -shift))
            slopes[j] = (up - down) / (2 * DIFFERENCE_STEP)
            log_slopes[j] = (np.log(up_var) - np.log(down_var)) / (2 * DIFFERENCE_STEP)
        inverse = np.divide(1.0, prior, out=np.zeros(4), where=prior > 0)
        scaled = slopes / np.sqrt(variance)
        of_variance = 0.5 * log_slopes @ (1.0 - found**2 / variance)
        gradient = (
            slopes @ (found / variance) + of_variance + inverse * (log_parameters - self.mean[PARAMETERS_AND_MASS])
        )
        return gradient, scaled @ scaled.T + 0.5 * log_slopes @ log_slopes.T + np.diag(inverse)

    def cost(self, log_parameters: np.ndarray) -> float:
        """Return the negative log posterior up to a constant; infinite if the filter fails."""
        found, variance = self.innovations(log_parameters)
        prior = self.prior_var
        off = (log_parameters - self.mean[PARAMETERS_AND_MASS])[prior > 0] ** 2 / prior[prior > 0]
        value = 0.5 * float(np.sum(found**2 / variance + np.log(variance)) + np.sum(off))
        return value if np.isfinite(value) else np.inf


def maximize_posterior(problem: PosteriorProblem, log_parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the likeliest log alpha, log beta, log d, log m, (4,), and their standard deviations, (4,).

    `log_parameters`: start of the search, (4,).
    """
    at, cost = log_parameters.copy(), problem.cost(log_parameters)
    free = problem.prior_var > 0
    information = np.eye(4)
    for _ in range(ITERATIONS):
        gradient, information = problem.compute_gradient_and_information(at)
        step = np.zeros(4)
        step[free] = -np.linalg.solve(information[np.ix_(free, free)], gradient[free])
        step *= min(1.0, MAX_STEP / max(float(np.abs(step).max()), 1e-12))
        while np.abs(step).max() > STEP_TOLERANCE and not problem.cost(at + step) < cost:
            step *= 0.5
        if np.abs(step).max() <= STEP_TOLERANCE:
            break
        at = at + step
        cost = problem.cost(at)
    return at, _compute_standard_deviations(information, free)


def log_evidence(problem: PosteriorProblem, log_parameters: np.ndarray) -> float:
    """Return Laplace's approximation of the samples' log probability under the problem's prior.

    `log_parameters`: start of the search for the likeliest parameters, (4,).
    """
    at, _ = maximize_posterior(problem, log_parameters)
    _, information = problem.compute_gradient_and_information(at)
    free = problem.prior_var > 0
    _, log_det = np.linalg.slogdet(information[np.ix_(free, free)])
    return -problem.cost(at) - 0.5 * log_det - 0.5 * float(np.sum(np.log(problem.prior_var[free])))


def compute_cramer_rao_bound(information: np.ndarray) -> np.ndarray:
    """Return the Bayesian Cramér-Rao bound (van Trees): least SD of log alpha, beta, d, and alpha times beta, (4,).

    `information`: from `PosteriorProblem.compute_gradient_and_information` at the truth, (4, 4), averaged over many
    grasps. Noise and guesses count as Gaussian with their variance.
    """
    free = np.diag(information) > 0
    cov = np.zeros((4, 4))
    cov[np.ix_(free, free)] = np.linalg.inv(information[np.ix_(free, free)])
    stiffness = cov[0, 0] + cov[1, 1] + 2 * cov[0, 1]
    return np.sqrt(np.append(np.diag(cov)[:3], stiffness))


def _compute_standard_deviations(information: np.ndarray, free: np.ndarray) -> np.ndarray:
    sd = np.zeros(4)
    sd[free] = np.sqrt(np.diag(np.linalg.inv(information[np.ix_(free, free)])))
    return sd


@compiled
def compute_innovations(
    mean: np.ndarray, cov: np.ndarray, samples: np.ndarray, noise: FilterNoise
) -> tuple[np.ndarray, np.ndarray]:
    """Return innovations and their variances, (n - 1,) each, of a filter with fixed parameters."""
    n = len(samples) - 1
    found, variances = np.empty(n), np.empty(n)
    step, rows, gain = np.empty((2, 4)), np.empty((2, STATE_COUNT)), np.empty(STATE_COUNT)
    about = mean[PARAMETERS_AND_MASS].copy()
    for i in range(n):
        sample = samples[i + 1]
        predict(mean, cov, about, samples[i], sample, noise, step, rows)
        for j in range(LOG_ALPHA, LOG_MASS + 1):  # known parameters do not walk
            cov[j, j] = 0.0
        variances[i] = project_covariance(cov, sample[METRE_PER_VOLT], gain) + noise.displacement_var
        found[i] = sample[DISPLACEMENT] - mean[X] - mean[OFFSET] - sample[METRE_PER_VOLT] * mean[STRAIN_NOISE]
        mean += gain * (found[i] / variances[i])
        cov -= gain.reshape(-1, 1) * gain / variances[i]
    return found, variances
