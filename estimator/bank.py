"""The bank of extended Kalman filters, one a tissue, compiled.

State of each filter: [x, x', log alpha, log beta, log d, offset, strain noise]. Logarithms keep parameters positive.
`offset` is what the displacement at contact is wrong by. `strain noise` is the strain gage's error of the present
sample, V: it enters the force (input) and the displacement (measurement) together, Eqs. (1) and (3), so it has to be
a state for their correlation to be right. Input u is the mean of the force at both ends of a step.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from config.schema import TissueLibrary, Tool
from estimator.model import EXPONENT_LIMIT, acceleration, elastic_force, step_matrices, tangent_stiffness

STATES = 7
X, V, LOG_ALPHA, LOG_BETA, LOG_DAMPING, OFFSET, STRAIN = range(STATES)

# What the paper leaves unstated (P0, Qw, R, initial guesses), stated here with reasons:
PRIOR_WIDENING = 2.0  # a filter's prior is wider than its tissue's spread, so that it can follow its neighbours' data
CONTACT_PAST_M = 15e-6  # contact falls between two samples, which are up to 30 µm apart: this far back on average
CONTACT_SD_M = 20e-6
VELOCITY_SD_M_PER_S = 0.05  # the jaws arrive at about 30 mm/s
FORCE_NOISE_SD_N = 0.005  # friction and the force's path between two samples
DISPLACEMENT_FLOOR_SD_M = 2e-6  # encoder count (1 µm) and its rounding
LOG_WALK_SD = np.array([2e-4, 2e-4, 1e-3])  # a sample: tissue drifts slowly under load
LOG_RANGE = 7.0  # a parameter further than a factor 1,100 from its guess has run away
NIS_SURPRISING = 16.0  # four standard deviations: the linearisation has misled the filter, so it gets less sure
WIDENING_MOST = 4.0  # times the covariance, in one sample
NIS_MEMORY = 0.95  # of the running mean of the normalised innovation squared
NIS_DIVERGED = 50.0


@dataclass(frozen=True, slots=True)
class Priors:
    """Per tissue: mean and SD of (log alpha, log beta, log d), each of shape (tissues, 3)."""

    names: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray
    mass_kg: float

    @classmethod
    def of(cls, library: TissueLibrary) -> "Priors":
        mean = [(t.alpha_n, t.beta_per_m, t.damping_kg_per_s) for t in library.tissues.values()]
        spreads = [library.spread_of(name) for name in library.tissues]
        sd = [(s.log_alpha, s.log_beta, s.log_damping) for s in spreads]
        return cls(tuple(library.tissues), np.log(mean), np.array(sd), library.mass_kg)


@dataclass(slots=True)
class BankState:
    """Everything the bank remembers; K filters."""

    mean: np.ndarray  # (K, 7)
    cov: np.ndarray  # (K, 7, 7)
    log_likelihood: np.ndarray  # (K,) sum over the grasp
    nis_sum: np.ndarray  # (K,) normalised innovations squared
    nis_recent: np.ndarray  # (K,) their running mean
    valid: np.ndarray  # (K,) bool; False once diverged
    updates: np.ndarray  # (1,) measurements taken
    last_force: np.ndarray  # (1,) N

    def copy(self) -> "BankState":
        return BankState(*(getattr(self, name).copy() for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class Contact:
    """A grasp's first sample in contact. `unfelt_force_n` may press before it is felt; 0 where a sensor tells."""

    force_n: float
    metre_per_volt: float
    velocity_m_per_s: float = 0.0
    unfelt_force_n: float = 0.0


class Bank:
    """Four filters (as many as the library has tissues) on one grasp's force and displacement."""

    def __init__(self, tool: Tool, library: TissueLibrary) -> None:
        self.priors = Priors.of(library)
        self.filter_sd = self.priors.sd * PRIOR_WIDENING
        self.dt_s = 1.0 / tool.board.sample_rate_hz
        self.strain_var = tool.noise.strain_sd_v**2 + tool.noise.strain_lsb_v**2 / 12
        self._settings = np.array([
            self.dt_s, library.mass_kg, self.strain_var, FORCE_NOISE_SD_N**2, DISPLACEMENT_FLOOR_SD_M**2,
        ])  # fmt: skip
        self.state = self._blank()

    def _blank(self) -> BankState:
        k = len(self.priors.names)
        return BankState(
            np.zeros((k, STATES)), np.zeros((k, STATES, STATES)), np.zeros(k), np.zeros(k), np.ones(k),
            np.ones(k, bool), np.zeros(1, np.int64), np.zeros(1),
        )  # fmt: skip

    def start(self, first: Contact) -> None:
        """Begin a grasp at its first sample in contact, where the measured displacement counts from.

        Sensed contact happened within the last sample. Contact found from the force lies back by what each tissue needs
        to make itself felt. Either way x + offset + strain noise is the measured zero.
        """
        state = self.state = self._blank()
        state.last_force[0] = first.force_n
        state.mean[:, LOG_ALPHA : LOG_DAMPING + 1] = self.priors.mean
        for mean, cov, sd in zip(state.mean, state.cov, self.filter_sd, strict=True):
            alpha, beta = np.exp(mean[LOG_ALPHA : LOG_BETA + 1])
            unfelt_m = math.log1p(first.unfelt_force_n / alpha) / beta
            x_var = CONTACT_SD_M**2 + unfelt_m**2
            mean[X], mean[V] = CONTACT_PAST_M + 0.5 * unfelt_m, first.velocity_m_per_s
            mean[OFFSET] = -mean[X]
            np.fill_diagonal(cov, [x_var, VELOCITY_SD_M_PER_S**2, *sd**2, x_var, self.strain_var])
            cov[X, OFFSET] = cov[OFFSET, X] = -x_var
            cov[OFFSET, STRAIN] = cov[STRAIN, OFFSET] = -first.metre_per_volt * self.strain_var
            cov[OFFSET, OFFSET] += first.metre_per_volt**2 * self.strain_var

    def is_believed(self, k: int) -> bool:
        """Whether filter k has neither diverged nor lost the data just now."""
        return bool(self.state.valid[k] and self.state.nis_recent[k] < NIS_DIVERGED)

    def advance(
        self, force_n: np.ndarray, displacement_m: np.ndarray, newton_per_volt: np.ndarray, metre_per_volt: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Take samples of shape (n,) each.

        Returns:
            The filters' means, (n, K, 7), and variances, (n, K, 7), after each sample; NaN where a filter has diverged.
        """
        shape = (len(force_n), len(self.priors.names), STATES)
        means, variances = np.empty(shape), np.empty(shape)
        s = self.state
        advance_bank(
            force_n, displacement_m, newton_per_volt, metre_per_volt, self._settings, LOG_WALK_SD**2, self.priors.mean,
            s.mean, s.cov, s.log_likelihood, s.nis_sum, s.nis_recent, s.valid, s.updates, s.last_force,
            means, variances,
        )  # fmt: skip
        return means, variances


@njit(cache=True)
def advance_bank(
    force_n, displacement_m, newton_per_volt, metre_per_volt, settings, log_walk_var, guess,
    mean, cov, log_likelihood, nis_sum, nis_recent, valid, updates, last_force, means, variances,
):  # fmt: skip
    """Advance all filters over all samples; see Bank.advance for shapes."""
    step = np.empty((2, 4))
    rows = np.empty((2, STATES))
    gain = np.empty(STATES)
    for i in range(len(force_n)):
        middle_n = 0.5 * (last_force[0] + force_n[i])
        for k in range(len(mean)):
            if valid[k]:
                predict(mean[k], cov[k], middle_n, newton_per_volt[i], settings, log_walk_var, step, rows)
                innovation, variance = update(mean[k], cov[k], displacement_m[i], metre_per_volt[i], settings[4], gain)
                nis = innovation * innovation / variance
                log_likelihood[k] -= 0.5 * (nis + math.log(2.0 * math.pi * variance))
                nis_sum[k] += nis
                nis_recent[k] = NIS_MEMORY * nis_recent[k] + (1.0 - NIS_MEMORY) * nis
                valid[k] = is_sound(mean[k], cov[k], guess[k])
            for j in range(STATES):
                sound = valid[k] and nis_recent[k] < NIS_DIVERGED
                means[i, k, j] = mean[k, j] if sound else np.nan
                variances[i, k, j] = cov[k, j, j] if sound else np.nan
        updates[0] += 1
        last_force[0] = force_n[i]


@njit(cache=True)
def predict(mean, cov, force_n, newton_per_volt, settings, log_walk_var, step, rows):
    """Time update over one sample, in place, Eqs. (14), (15), (19), (20) with a stable step.

    `step` (2, 4) and `rows` (2, 7) are scratch space.
    """
    dt_s, mass_kg, strain_var, force_var = settings[0], settings[1], settings[2], settings[3]
    alpha, beta, damping = math.exp(mean[LOG_ALPHA]), math.exp(mean[LOG_BETA]), math.exp(mean[LOG_DAMPING])
    x, v = mean[X], mean[V]
    elastic = elastic_force(alpha, beta, x)
    stiffness = tangent_stiffness(alpha, beta, x)
    true_force = force_n - 0.5 * newton_per_volt * mean[STRAIN]
    change = acceleration(mass_kg, x, v, alpha, beta, damping, true_force)
    step_matrices(mass_kg, stiffness, damping, dt_s, step)
    mean[X] += step[0, 2] * v + step[0, 3] * change
    mean[V] += step[1, 2] * v + step[1, 3] * change
    mean[STRAIN] = 0.0

    by_alpha, by_beta = -elastic / mass_kg, -stiffness * x / mass_kg
    by_damping, by_strain = -damping * v / mass_kg, -0.5 * newton_per_volt / mass_kg
    for r in range(2):  # rows of Phi P for x and v
        g = step[r, 3]
        for j in range(STATES):
            rows[r, j] = (
                step[r, 0] * cov[X, j] + step[r, 1] * cov[V, j]
                + g * (by_alpha * cov[LOG_ALPHA, j] + by_beta * cov[LOG_BETA, j] + by_damping * cov[LOG_DAMPING, j]
                       + by_strain * cov[STRAIN, j])
            )  # fmt: skip
    for r in range(2):
        for q in range(r + 1):
            g = step[q, 3]
            value = (
                step[q, 0] * rows[r, X] + step[q, 1] * rows[r, V]
                + g * (by_alpha * rows[r, LOG_ALPHA] + by_beta * rows[r, LOG_BETA] + by_damping * rows[r, LOG_DAMPING]
                       + by_strain * rows[r, STRAIN])
            )  # fmt: skip
            value += step[r, 3] * g * (by_strain * by_strain * strain_var + force_var / (mass_kg * mass_kg))
            cov[r, q] = value
            cov[q, r] = value
        for j in range(LOG_ALPHA, OFFSET + 1):
            cov[r, j] = rows[r, j]
            cov[j, r] = rows[r, j]
    for j in range(STATES):
        cov[STRAIN, j] = 0.0
        cov[j, STRAIN] = 0.0
    cov[STRAIN, STRAIN] = strain_var
    for r in range(2):  # the new sample's strain noise drives half of the step
        cov[r, STRAIN] = step[r, 3] * by_strain * strain_var
        cov[STRAIN, r] = cov[r, STRAIN]
    for j in range(3):
        cov[LOG_ALPHA + j, LOG_ALPHA + j] += log_walk_var[j]


@njit(cache=True)
def update(mean, cov, displacement_m, metre_per_volt, displacement_var, gain):
    """Measurement update, in place, for y = x + offset + (dx/dV) strain + noise, Eqs. (16) to (18).

    Returns the innovation, m, and its variance, m². `gain` (7,) is scratch space.
    """
    innovation = displacement_m - mean[X] - mean[OFFSET] - metre_per_volt * mean[STRAIN]
    variance = project(cov, metre_per_volt, gain) + displacement_var
    believed = variance
    surprise = innovation * innovation / variance / NIS_SURPRISING
    if surprise > 1.0:
        widen(cov, min(surprise, WIDENING_MOST))
        believed = project(cov, metre_per_volt, gain) + displacement_var
    for j in range(STATES):
        mean[j] += gain[j] * innovation / believed
    for j in range(STATES):
        for q in range(j + 1):
            value = cov[j, q] - gain[j] * gain[q] / believed
            cov[j, q] = value
            cov[q, j] = value
    return innovation, variance


@njit(cache=True)
def project(cov, metre_per_volt, gain):
    """P Hᵀ into `gain` (7,); returns H P Hᵀ, m²."""
    for j in range(STATES):
        gain[j] = cov[j, X] + cov[j, OFFSET] + metre_per_volt * cov[j, STRAIN]
    return gain[X] + gain[OFFSET] + metre_per_volt * gain[STRAIN]


@njit(cache=True)
def widen(cov, factor):
    """Be less sure of everything but the strain noise by `factor`, in place."""
    root = math.sqrt(factor)
    for j in range(STATES):
        for q in range(STATES):
            cov[j, q] *= (1.0 if j == STRAIN else root) * (1.0 if q == STRAIN else root)


@njit(cache=True)
def is_sound(mean, cov, guess):
    """False once a filter has diverged: not finite, a variance not positive, or a parameter run away."""
    for j in range(STATES):
        if not (math.isfinite(mean[j]) and cov[j, j] > 0.0):
            return False
    for j in range(3):
        if abs(mean[LOG_ALPHA + j] - guess[j]) > LOG_RANGE:
            return False
    return math.exp(mean[LOG_BETA]) * mean[X] < EXPONENT_LIMIT
