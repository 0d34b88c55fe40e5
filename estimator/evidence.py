"""From the bank to a probability for each tissue and for `unknown`.

The filter that fits best gives, as a Gaussian in (log alpha, log beta, log d), what the data say of the parameters;
that likelihood is moved from the filter's own prior to each tissue's, and to the wide prior of a thing outside
the library.
A plain product of each filter's innovation likelihoods commits too early and too surely.
"""

import math

import numpy as np
from numba import njit

from config.schema import Identification
from estimator.bank import LOG_ALPHA, Bank

NIS_TOLERATED = 1.5  # mean normalised innovation squared up to which the model counts as fitting
MISFIT_PENALTY = 10.0  # log-likelihood that "fits nothing" has to win before it counts


class Evidence:
    """Probabilities of the library's tissues, in its order, and of `unknown`, last."""

    def __init__(self, bank: Bank, settings: Identification) -> None:
        self._bank = bank
        priors = bank.priors
        centre = priors.mean.mean(axis=0)
        self._mean = np.vstack([priors.mean, centre])
        self._var = np.vstack([priors.sd**2, np.full(3, settings.unknown_spread_log**2)])
        known = (1.0 - settings.prior_unknown) / len(priors.names)
        self._log_prior = np.log([known] * len(priors.names) + [settings.prior_unknown])

    @property
    def prior(self) -> np.ndarray:
        """Probabilities before any data, (K + 1,)."""
        return np.exp(self._log_prior)

    def probabilities(self) -> tuple[np.ndarray, int]:
        """Posterior probabilities, (K + 1,), and which filter fits best (-1: none is valid, all is unknown)."""
        state = self._bank.state
        result = np.empty(len(self._log_prior))
        best = posterior(
            state.mean, state.cov, state.log_likelihood, state.nis_sum, state.valid, state.updates[0],
            self._bank.priors.mean, self._bank.filter_sd**2, self._mean, self._var, self._log_prior, result,
        )  # fmt: skip
        return result, best


@njit(cache=True)
def posterior(
    mean, cov, log_likelihood, nis_sum, valid, updates, guess, guess_var, tissue_mean, tissue_var, log_prior, result
):  # fmt: skip
    """Write the posterior into `result`; returns the index of the best filter or -1."""
    best = -1
    for k in range(len(mean)):
        if valid[k] and (best < 0 or log_likelihood[k] > log_likelihood[best]):
            best = k
    if best < 0 or updates == 0:
        result[:] = 0.0
        result[-1] = 1.0
        return best
    misfit = max(nis_sum[best] / updates / NIS_TOLERATED, 1.0)
    information, peak = likelihood_of_parameters(mean[best], cov[best], guess[best], guess_var[best], misfit)
    for j in range(len(result)):
        result[j] = log_prior[j] + moved_evidence(information, peak, tissue_mean[j], tissue_var[j])
    won = 0.5 * updates * (misfit - 1.0 - math.log(misfit)) - MISFIT_PENALTY
    result[-1] += max(won, 0.0)
    normalise(result)
    return best


@njit(cache=True)
def likelihood_of_parameters(mean, cov, guess, guess_var, misfit):
    """What the data alone say: information matrix (3, 3) and information vector (3,) of the log parameters.

    The filter's posterior divided by its prior; a model that fits badly is believed less, by `misfit`.
    """
    inner = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            inner[i, j] = cov[LOG_ALPHA + i, LOG_ALPHA + j]
    if not np.linalg.det(inner) > 0.0:  # no proper covariance: nothing is learned from it
        return np.zeros((3, 3)), np.zeros(3)
    information = np.linalg.inv(inner)
    vector = information @ mean[LOG_ALPHA : LOG_ALPHA + 3]
    for i in range(3):
        information[i, i] -= 1.0 / guess_var[i]
        vector[i] -= guess[i] / guess_var[i]
    return information / misfit, vector / misfit


@njit(cache=True)
def moved_evidence(information, vector, tissue_mean, tissue_var):
    """log of the integral of the parameters' likelihood over a Gaussian prior, up to a constant common to all."""
    joint = information.copy()
    target = vector.copy()
    value = 0.0
    for i in range(3):
        joint[i, i] += 1.0 / tissue_var[i]
        target[i] += tissue_mean[i] / tissue_var[i]
        value -= 0.5 * (tissue_mean[i] ** 2 / tissue_var[i] + math.log(tissue_var[i]))
    sign, log_det = np.linalg.slogdet(joint)
    if sign <= 0:
        return -np.inf
    return value + 0.5 * (target @ np.linalg.solve(joint, target)) - 0.5 * log_det


@njit(cache=True)
def normalise(log_weights):
    """Logarithms of weights to probabilities that sum to 1, in place."""
    log_weights -= log_weights.max()
    np.exp(log_weights, log_weights)
    log_weights /= log_weights.sum()
