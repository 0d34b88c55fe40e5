"""The class BankEvidence, which computes a probability for each tissue and for `unknown` from the filter bank.

From each kind of filter (strict and lenient) the best-fitting one counts. Its posterior without its own prior is a
Gaussian likelihood of (log alpha, log beta, log d). This likelihood is combined with each tissue's prior, and with a
wide prior for things outside the library. The kinds are weighted by how well they explain the data. Where even the
best lenient filter fits badly, the probability of `unknown` rises. A plain product of innovation likelihoods would
commit too early and too surely.

The tissue's thickness at contact is further evidence, where the tool senses contact and its jaw opening is known.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from acquisition.compilation import compiled
from config.schema import IdentificationSettings, TissueLibrary
from estimator.constants import (
    FILLED_JAWS_MARGIN_M,
    FOLD_PROBABILITY,
    GRASP_SCATTER_LOG_SD,
    MODEL_ERROR_LOG_SD,
    NIS_TOLERANCE,
    SURPRISE_EFFECTIVE_SAMPLES,
    SURPRISE_TOLERANCE,
    UNKNOWN_LOG_THICKNESS_SD,
    UNKNOWN_THICKNESS_M,
)
from estimator.filter_bank import FilterBank
from estimator.kalman_filter import INFLATION, LOG_ALPHA, LOG_LIKELIHOOD, NIS_SUM, find_likeliest_filter

UNINFORMATIVE_VAR = 1e100  # variance of a prior without information


@dataclass(frozen=True, slots=True)
class GraspLikelihood:
    """What the bank knows of a finished grasp, apart from all priors.

    For each kind of filter: log of the likelihood's peak, (K,); information matrix, (K, 3, 3), and vector, (K, 3), of
    log alpha, log beta and log d. A kind that diverged has the peak -inf. `other`: further log-likelihoods, (M + 1,).
    """

    log_weight: np.ndarray
    information: np.ndarray
    vector: np.ndarray
    other: np.ndarray


class BankEvidence:
    """Probabilities of the library's M tissues in its order, then of `unknown`, from a filter bank."""

    def __init__(self, bank: FilterBank, library: TissueLibrary, settings: IdentificationSettings) -> None:
        self._bank = bank
        priors = bank.priors
        self._mean = np.vstack([priors.mean, priors.mean.mean(axis=0)])
        self._var = np.vstack([priors.sd**2, np.full(3, settings.unknown_spread_log**2)]) + MODEL_ERROR_LOG_SD**2
        known = (1.0 - settings.prior_unknown) / len(priors.names)
        self._log_prior = np.log([known] * len(priors.names) + [settings.prior_unknown])
        self._thickness = ThicknessEvidence(library)

    @property
    def prior(self) -> np.ndarray:
        """Prior probabilities of the tissues and of `unknown`, (M + 1,)."""
        return np.exp(self._log_prior)

    def compute_thickness_log_likelihood(self, travel_m: float, opening_m: float) -> np.ndarray:
        """Return log-likelihoods, (M + 1,), of first contact after closing by `travel_m` from `opening_m`."""
        return self._thickness.log_likelihood(travel_m, opening_m)

    def probabilities(self, log_likelihood: np.ndarray | float = 0.0) -> np.ndarray:
        """Return posterior probabilities, (M + 1,), by the bank and `log_likelihood`, (M + 1,), of other evidence."""
        state = self._bank.state
        result = np.empty(len(self._log_prior))
        compute_posterior(
            state.mean,
            state.cov,
            state.fit_statistics,
            state.valid,
            state.samples_taken[0],
            state.surprise[0],
            self._bank.priors.mean,
            self._bank.filter_sd**2,
            self._mean,
            self._var,
            self._log_prior + log_likelihood,
            result,
        )
        return result

    def measure_likelihood(self, log_likelihood: np.ndarray | float = 0.0) -> GraspLikelihood:
        """Return the grasp's likelihood by the bank so far and `log_likelihood`, (M + 1,), of other evidence."""
        state, priors, tissues = self._bank.state, self._bank.priors, len(self._bank.priors.names)
        kinds = len(state.mean) // tissues
        found = GraspLikelihood(
            np.full(kinds, -np.inf), np.zeros((kinds, 3, 3)), np.zeros((kinds, 3)), np.zeros(tissues + 1)
        )
        for kind in range(kinds):
            best = find_likeliest_filter(kind * tissues, (kind + 1) * tissues, state.fit_statistics, state.valid)
            if best < 0:
                continue
            fit = state.fit_statistics[best]
            own = priors.mean[best % tissues]
            own_var = self._bank.filter_sd[best % tissues] ** 2 * min(fit[INFLATION], UNINFORMATIVE_VAR)
            misfit = max(fit[NIS_SUM] / max(state.samples_taken[0] - 1, 1) / NIS_TOLERANCE, 1.0)
            information, vector = compute_parameter_likelihood(state.mean[best], state.cov[best], own, own_var)
            # the marginal likelihood is up to a constant, half the vector times the mean: here it does not cancel
            found.log_weight[kind] = (
                fit[LOG_LIKELIHOOD]
                - compute_marginal_log_likelihood(information, vector, own, own_var)
                + 0.5 * float(vector @ np.linalg.pinv(information) @ vector)
            )
            found.information[kind], found.vector[kind] = information / misfit, vector / misfit
        excess = max(float(state.surprise[0]) / SURPRISE_TOLERANCE, 1.0)
        found.other[-1] = 0.5 * SURPRISE_EFFECTIVE_SAMPLES * (excess - 1.0 - math.log(excess))
        found.other[:] += log_likelihood
        return found

    def combine_grasps(self, grasps: Sequence[GraspLikelihood]) -> np.ndarray:
        """Return posterior probabilities, (M + 1,), of the tissue of a spot from several grasps on it.

        The spot's parameters are one draw of the tissue's prior, and each grasp scatters a little about them. So every
        further grasp tells more of the spot, and never more than the spot tells of the tissue. Thickness and misfit
        belong to the spot: their mean counts once.
        """
        if not grasps:
            return self.prior
        scatter_var = GRASP_SCATTER_LOG_SD**2
        result = np.full(len(self._log_prior), -np.inf)
        for kind in range(len(grasps[0].log_weight)):
            common, information, vector = 0.0, np.zeros((3, 3)), np.zeros(3)
            for each in grasps:
                blurring = np.linalg.inv(np.eye(3) + each.information[kind] * scatter_var)
                blurred_vector = blurring @ each.vector[kind]
                mean = np.linalg.pinv(each.information[kind]) @ each.vector[kind]
                common += each.log_weight[kind] + 0.5 * np.linalg.slogdet(blurring)[1] - 0.5 * blurred_vector @ mean
                information += blurring @ each.information[kind]
                vector += blurred_vector
            if not np.isfinite(common):
                continue
            for j in range(len(result)):
                of_spot = compute_marginal_log_likelihood(
                    information, vector, self._mean[j], self._var[j] - scatter_var
                )
                result[j] = np.logaddexp(result[j], common + of_spot)
        if not np.isfinite(result.max()):
            result[-1] = 0.0
        result += self._log_prior + np.mean([each.other for each in grasps], axis=0)
        normalize_log_weights(result)
        return result


class ThicknessEvidence:
    """Evidence for a tissue from its thickness, the gap between the jaws at first contact."""

    def __init__(self, library: TissueLibrary) -> None:
        thickness_m = [profile.thickness_m for profile in library.tissues.values()]
        sd = [library.spread_of(name).log_thickness for name in library.tissues]
        self._log_mean = np.log([*thickness_m, UNKNOWN_THICKNESS_M])
        self._sd = np.array([*sd, UNKNOWN_LOG_THICKNESS_SD])

    def log_likelihood(self, travel_m: float, opening_m: float) -> np.ndarray:
        """Return log-likelihoods, (M + 1,), of first contact after closing by `travel_m` from `opening_m`.

        Tissue that fills the open jaws counts as at least as thick as they open.
        """
        if travel_m < FILLED_JAWS_MARGIN_M:
            at_least = math.log(max(opening_m - FILLED_JAWS_MARGIN_M, FILLED_JAWS_MARGIN_M))
            own = log_ndtr((self._log_mean - at_least) / self._sd)
        else:
            gap = math.log(max(opening_m - travel_m, FILLED_JAWS_MARGIN_M / 10))
            own = -0.5 * ((gap - self._log_mean) / self._sd) ** 2 - np.log(self._sd * math.sqrt(2 * math.pi))
        return np.logaddexp(math.log(1 - FOLD_PROBABILITY) + own, math.log(FOLD_PROBABILITY) + own[-1])


@compiled
def compute_posterior(
    mean: np.ndarray,
    cov: np.ndarray,
    fit: np.ndarray,
    valid: np.ndarray,
    taken: int,
    surprise: float,
    guess: np.ndarray,
    guess_var: np.ndarray,
    tissue_mean: np.ndarray,
    tissue_var: np.ndarray,
    log_prior: np.ndarray,
    result: np.ndarray,
) -> None:
    """Write the posterior probabilities into `result`, (M + 1,); `unknown` gets 1 if no filter is valid."""
    tissues = len(guess)
    result[:] = -np.inf
    for first in range(0, len(mean), tissues):
        best = find_likeliest_filter(first, first + tissues, fit, valid)
        if best >= 0:
            # inflating the covariance by f leaves 1/f of all information, including the prior's
            own, own_var = guess[best - first], guess_var[best - first] * min(fit[best, INFLATION], UNINFORMATIVE_VAR)
            misfit = max(fit[best, NIS_SUM] / max(taken - 1, 1) / NIS_TOLERANCE, 1.0)
            information, vector = compute_parameter_likelihood(mean[best], cov[best], own, own_var)
            common = fit[best, LOG_LIKELIHOOD] - compute_marginal_log_likelihood(information, vector, own, own_var)
            information /= misfit
            vector /= misfit
            for j in range(len(result)):
                value = (
                    common
                    + log_prior[j]
                    + compute_marginal_log_likelihood(information, vector, tissue_mean[j], tissue_var[j])
                )
                result[j] = np.logaddexp(result[j], value)
    excess = max(surprise / SURPRISE_TOLERANCE, 1.0)
    result[-1] += 0.5 * SURPRISE_EFFECTIVE_SAMPLES * (excess - 1.0 - math.log(excess))
    if not np.isfinite(result.max()):
        result[:] = -np.inf
        result[-1] = 0.0
    normalize_log_weights(result)


@compiled
def compute_parameter_likelihood(
    mean: np.ndarray, cov: np.ndarray, guess: np.ndarray, prior_var: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the data's information matrix (3, 3) and information vector (3,) of the log parameters.

    It is the filter's posterior divided by the rest of its prior; the matrix is positive semi-definite.
    """
    inner = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            inner[i, j] = cov[LOG_ALPHA + i, LOG_ALPHA + j]
    if not np.linalg.det(inner) > 0.0:  # not a proper covariance: no information
        return np.zeros((3, 3)), np.zeros(3)
    posterior_information = np.linalg.inv(inner)
    seen = mean[LOG_ALPHA : LOG_ALPHA + 3]
    learned = posterior_information.copy()
    for i in range(3):
        learned[i, i] -= 1.0 / prior_var[i]
    if compute_marginal_log_likelihood(learned, guess, guess, np.full(3, UNINFORMATIVE_VAR)) > -np.inf:
        return learned, posterior_information @ seen - guess / prior_var
    # Along some directions the parameters' random walk may have cost more information than the data gave. Keep only
    # the directions with a gain, in units of the prior's SD, centered on the filter's mean.
    sd = np.sqrt(prior_var)
    size, direction = np.linalg.eigh(learned * np.outer(sd, sd))
    learned[:] = 0.0
    for i in range(3):
        if size[i] > 0.0:
            axis = direction[:, i] / sd
            learned += size[i] * np.outer(axis, axis)
    return learned, learned @ seen


@compiled
def compute_marginal_log_likelihood(
    information: np.ndarray, vector: np.ndarray, tissue_mean: np.ndarray, tissue_var: np.ndarray
) -> float:
    """Return the log of the integral of likelihood times Gaussian prior, up to a constant common to all tissues.

    -inf if the product is not a density. The Cholesky factorization of the joint information is written out, because
    calls of LAPACK cost more than all filters together.
    """
    value = 0.0
    target = np.empty(3)
    for i in range(3):
        target[i] = vector[i] + tissue_mean[i] / tissue_var[i]
        value -= 0.5 * (tissue_mean[i] ** 2 / tissue_var[i] + math.log(tissue_var[i]))
    a = information[0, 0] + 1.0 / tissue_var[0]
    if not a > 0.0:
        return -np.inf
    root_a = math.sqrt(a)
    lower_b, lower_c = information[1, 0] / root_a, information[2, 0] / root_a
    b = information[1, 1] + 1.0 / tissue_var[1] - lower_b * lower_b
    if not b > 0.0:
        return -np.inf
    root_b = math.sqrt(b)
    lower_d = (information[2, 1] - lower_b * lower_c) / root_b
    c = information[2, 2] + 1.0 / tissue_var[2] - lower_c * lower_c - lower_d * lower_d
    if not c > 0.0:
        return -np.inf
    first = target[0] / root_a
    second = (target[1] - lower_b * first) / root_b
    third = (target[2] - lower_c * first - lower_d * second) / math.sqrt(c)
    return value + 0.5 * (first * first + second * second + third * third - math.log(a * b * c))


@compiled
def normalize_log_weights(log_weights: np.ndarray) -> None:
    """Convert log weights to probabilities that sum to 1, in place."""
    log_weights -= log_weights.max()
    np.exp(log_weights, log_weights)
    log_weights /= log_weights.sum()
