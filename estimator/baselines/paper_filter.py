"""The paper's own filter, Eqs. (9) to (20), corrected only where it cannot work as printed.

Corrected: the missing terms of the Jacobian (10); the unstable Euler step (19), replaced by the exact local step; (10)
and (11) extended to five states. As printed: linear parameters, the previous sample's measured force as input, a
diagonal process noise that enters through G, displacement as the only measurement, 10 Hz Butterworth signals.
"""

import math
from dataclasses import dataclass

import numpy as np

from acquisition.compilation import compiled
from config.schema import IdentificationSettings, TissueLibrary, Tool
from estimator.constants import EXPONENT_LIMIT
from estimator.criteria import convergence_samples
from estimator.filter_bank import ContactStart, TissuePriors
from estimator.tissue_model import elastic_force, elastic_force_array, step_matrices, tangent_stiffness

STATE_COUNT = 5
X, V, ALPHA, BETA, DAMPING = range(STATE_COUNT)

# The paper does not state P0 and Qw; these reproduce Tables III and IV as printed from close guesses.
GUESS_SHARE_SD = np.array([0.25, 0.10, 0.30])  # share of the guesses: the library's spreads
VELOCITY_SD_M_PER_S = 0.05
RANDOM_WALK_SHARE = np.array([1e-3, 1e-3, 1e-2])  # share of the guesses per square root of a second
FILTERED_NOISE_SHARE = 0.15  # share of white noise after the 10 Hz low-pass: sqrt(2 * 11 Hz / 1000 Hz)


@dataclass(frozen=True, slots=True)
class PaperNoise:
    """Standard deviations of the input, N, and of the measured displacement, m."""

    force_sd_n: float
    displacement_sd_m: float


class PaperFilterBank:
    """Bank of the paper's filters, one for each initial guess, on the same force and displacement."""

    def __init__(
        self,
        guess: np.ndarray,
        mass_kg: float,
        dt_s: float,
        noise: PaperNoise,
        guess_share_sd: np.ndarray = GUESS_SHARE_SD,
    ) -> None:
        """Create K filters; `guess`: alpha N, beta 1/m, d kg/s, (K, 3); `guess_share_sd`: its SD as a share, (3,)."""
        self._guess, self._mass_kg, self._dt_s, self._noise = np.asarray(guess, float), mass_kg, dt_s, noise
        self._guess_share_sd = guess_share_sd
        self.start(0.0)

    def start(self, force_n: float, velocity_m_per_s: float = 0.0) -> None:
        """Begin at contact, with the force and velocity there."""
        k = len(self._guess)
        self.mean, self.cov = np.zeros((k, STATE_COUNT)), np.zeros((k, STATE_COUNT, STATE_COUNT))
        self.mean[:, V], self.mean[:, ALPHA:] = velocity_m_per_s, self._guess
        for cov, guess in zip(self.cov, self._guess, strict=True):
            start = [self._noise.displacement_sd_m, VELOCITY_SD_M_PER_S, *(self._guess_share_sd * guess)]
            np.fill_diagonal(cov, np.square(start))
        self.log_likelihood, self.valid = np.zeros(k), np.ones(k, bool)
        self._previous_force_n = np.array([force_n])

    def advance(self, force_n: np.ndarray, displacement_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Process samples, (n,) each; return means, (n, K, 5), and elastic forces N, (n, K); NaN once diverged."""
        means = np.empty((len(force_n), len(self._guess), STATE_COUNT))
        walk_var = np.square(RANDOM_WALK_SHARE * self._guess) * self._dt_s
        _advance_bank(
            force_n,
            displacement_m,
            self._previous_force_n,
            self._mass_kg,
            self._dt_s,
            self._noise.force_sd_n**2,
            self._noise.displacement_sd_m**2,
            walk_var,
            self.mean,
            self.cov,
            self.log_likelihood,
            self.valid,
            means,
        )
        return means, elastic_force_array(means[:, :, ALPHA], means[:, :, BETA], means[:, :, X])


@compiled
def _advance_bank(
    force_n: np.ndarray,
    displacement_m: np.ndarray,
    before_n: np.ndarray,
    mass_kg: float,
    dt_s: float,
    force_var: float,
    displacement_var: float,
    walk_var: np.ndarray,
    mean: np.ndarray,
    cov: np.ndarray,
    log_likelihood: np.ndarray,
    valid: np.ndarray,
    means: np.ndarray,
) -> None:
    step, transition = np.empty((2, 4)), np.eye(STATE_COUNT)
    for i in range(len(force_n)):
        for k in range(len(mean)):
            if valid[k]:
                _predict(mean[k], cov[k], before_n[0], mass_kg, dt_s, force_var, walk_var[k], step, transition)
                variance = cov[k, X, X] + displacement_var
                innovation = displacement_m[i] - mean[k, X]
                log_likelihood[k] -= 0.5 * (innovation**2 / variance + math.log(2 * math.pi * variance))
                gain = cov[k, :, X] / variance
                mean[k] += gain * innovation
                cov[k] -= gain.reshape(-1, 1) * gain * variance
                valid[k] = np.isfinite(mean[k]).all() and mean[k, BETA] * mean[k, X] < EXPONENT_LIMIT
            means[i, k] = np.nan
            if valid[k]:
                means[i, k] = mean[k]
        before_n[0] = force_n[i]


@compiled
def _predict(
    mean: np.ndarray,
    cov: np.ndarray,
    force_n: float,
    mass_kg: float,
    dt_s: float,
    force_var: float,
    walk_var: np.ndarray,
    step: np.ndarray,
    transition: np.ndarray,
) -> None:
    x, v, alpha, beta, damping = mean
    elastic = elastic_force(alpha, beta, x)
    stiffness = max(tangent_stiffness(alpha, beta, x), 1e-3)
    step_matrices(mass_kg, stiffness, damping, dt_s, step)
    held = force_n - elastic + stiffness * x
    for r in range(2):
        g = step[r, 2]
        mean[r] = step[r, 0] * x + step[r, 1] * v + g * held
        transition[r, X], transition[r, V] = step[r, 0], step[r, 1]
        transition[r, ALPHA] = -g * elastic / alpha
        transition[r, BETA] = -g * stiffness * x / beta
        transition[r, DAMPING] = -g * v
    cov[:] = transition @ np.ascontiguousarray(cov) @ transition.T
    cov[V, V] += force_var / mass_kg**2 * dt_s  # Eq. (15)
    for j in range(3):
        cov[ALPHA + j, ALPHA + j] += walk_var[j]


class PaperIdentifier:
    """The paper's bank on the Butterworth signals. Its probabilities are plain products of innovation likelihoods."""

    def __init__(self, tool: Tool, library: TissueLibrary, settings: IdentificationSettings) -> None:
        priors = TissuePriors.from_library(library)
        self._filtered_noise_sd_v = FILTERED_NOISE_SHARE * tool.noise.strain_sd_v
        self._guess, self._mass_kg = np.exp(priors.mean), library.mass_kg
        self._dt_s = 1.0 / tool.board.sample_rate_hz
        self._convergence_error = settings.convergence_error
        self._errors: list[np.ndarray] = []
        self._peak_n = 0.0

    def start(self, first: np.void, contact: ContactStart) -> None:
        noise = PaperNoise(
            self._filtered_noise_sd_v * float(first["newton_per_volt"]),
            self._filtered_noise_sd_v * abs(float(first["metre_per_volt"])),
        )
        self._bank = PaperFilterBank(self._guess, self._mass_kg, self._dt_s, noise)
        self._bank.start(float(first["jaw_force_filtered_n"]), contact.velocity_m_per_s)
        self._contact_m = float(first["jaw_displacement_filtered_m"])
        self._errors, self._peak_n = [], 0.0

    def advance(self, samples: np.ndarray) -> None:
        force_n = np.ascontiguousarray(samples["jaw_force_filtered_n"])
        displacement_m = samples["jaw_displacement_filtered_m"] - self._contact_m
        _, elastic_n = self._bank.advance(force_n, displacement_m)
        self._errors.append(elastic_n - force_n[:, None])
        self._peak_n = max(self._peak_n, float(force_n.max()))

    def probabilities(self) -> np.ndarray:
        weights = np.where(self._bank.valid, self._bank.log_likelihood, -np.inf)
        if not np.isfinite(weights.max()):
            return np.append(np.zeros(len(weights)), 1.0)
        likelihood = np.exp(weights - weights.max())
        return np.append(likelihood / likelihood.sum(), 0.0)

    def choose_by_criteria(self) -> int:
        """Return the index of the paper's answer: the guess with the earliest convergence, then the least error."""
        errors = np.concatenate(self._errors)
        converged = convergence_samples(errors, self._convergence_error * self._peak_n)  # NaN sorts last
        mean_error = np.nan_to_num(np.abs(errors), nan=np.inf).mean(axis=0)
        return int(np.lexsort((mean_error, converged))[0])

    def log_parameters(self) -> np.ndarray:
        if not self._bank.valid.any():
            return np.full(3, np.nan)
        best = int(np.argmax(np.where(self._bank.valid, self._bank.log_likelihood, -np.inf)))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(self._bank.mean[best, ALPHA:])
