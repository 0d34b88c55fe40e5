"""A particle filter, the paper's future work: particles over the parameters of every tissue and of `unknown`.

Each particle has fixed parameters. It estimates displacement, velocity, offset and strain noise with a small Kalman
filter (Rao-Blackwellized), so a few hundred particles per tissue suffice. If the weights degenerate, the particles of a
tissue are resampled and jittered with a shrunken kernel (Liu and West).
"""

import math

import numpy as np

from acquisition.compilation import compiled
from config.schema import IdentificationSettings, TissueLibrary, Tool
from estimator.constants import VELOCITY_SD_M_PER_S
from estimator.filter_bank import ContactStart, FilterTuning, TissuePriors, bank_columns, build_filter_tunings
from estimator.kalman_filter import DISPLACEMENT, ELAPSED_S, FORCE, METRE_PER_VOLT, NEWTON_PER_VOLT, FilterNoise
from estimator.tissue_model import elastic_force, step_matrices, tangent_stiffness

PARTICLES_PER_TISSUE = 400
KERNEL_SHRINKAGE = 0.98  # of Liu and West's kernel
MIN_EFFECTIVE_SHARE = 0.3  # effective share of particles below which they are resampled


class ParticleIdentifier:
    """Particle filter with the model, noise and start of the bank's strict filters; `seed` makes it repeatable."""

    def __init__(self, tool: Tool, library: TissueLibrary, settings: IdentificationSettings, seed: int = 0) -> None:
        self._priors, self._seed = TissuePriors.from_library(library), seed
        self._tuning: FilterTuning = build_filter_tunings(tool)[0]
        self._dt_s = 1.0 / tool.board.sample_rate_hz
        m = len(self._priors.names)
        self._mean = np.vstack([self._priors.mean, self._priors.mean.mean(axis=0)])
        self._sd = np.vstack([self._priors.sd, np.full(3, settings.unknown_spread_log)])
        self._log_prior = np.log([(1 - settings.prior_unknown) / m] * m + [settings.prior_unknown])

    def start(self, first: np.void, contact: ContactStart) -> None:
        self._rng = np.random.default_rng(self._seed)
        m = len(self._mean)
        draws = self._rng.standard_normal((m, PARTICLES_PER_TISSUE, 4))
        self._log_parameters = np.empty((m, PARTICLES_PER_TISSUE, 4))
        self._log_parameters[:, :, :3] = self._mean[:, None] + self._sd[:, None] * draws[:, :, :3]
        self._log_parameters[:, :, 3] = math.log(self._priors.mass_kg) + self._tuning.log_mass_sd * draws[:, :, 3]
        noise, by_volt = self._tuning.noise, contact.sample[METRE_PER_VOLT]
        unfelt_m = np.log1p(contact.undetected_force_n / np.exp(self._log_parameters[:, :, 0])) / np.exp(
            self._log_parameters[:, :, 1]
        )
        x_var = contact.initial_compression_sd_m**2 + unfelt_m**2
        self._state = np.zeros((m, PARTICLES_PER_TISSUE, 4))  # x, v, offset, strain noise
        self._state[:, :, 0] = contact.initial_compression_m + 0.5 * unfelt_m
        self._state[:, :, 1], self._state[:, :, 2] = contact.velocity_m_per_s, -self._state[:, :, 0]
        self._cov = np.zeros((m, PARTICLES_PER_TISSUE, 4, 4))
        self._cov[:, :, 0, 0], self._cov[:, :, 1, 1] = x_var, VELOCITY_SD_M_PER_S**2
        self._cov[:, :, 2, 2] = x_var + by_volt**2 * noise.strain_var + noise.displacement_var
        self._cov[:, :, 0, 2] = self._cov[:, :, 2, 0] = -x_var
        self._cov[:, :, 2, 3] = self._cov[:, :, 3, 2] = -by_volt * noise.strain_var
        self._cov[:, :, 3, 3] = noise.strain_var
        self._log_weight = np.full((m, PARTICLES_PER_TISSUE), -math.log(PARTICLES_PER_TISSUE))
        self._log_evidence = np.zeros(m)
        self._contact_m = float(first["jaw_displacement_m"])
        self._previous_sample = contact.sample.copy()
        self._previous_sample[DISPLACEMENT] = 0.0
        self._last_tick = int(first["tick"])

    def advance(self, samples: np.ndarray) -> None:
        columns = bank_columns(samples, self._contact_m, self._last_tick, self._dt_s)
        self._last_tick = int(samples["tick"][-1])
        for sample in columns:
            for log, state, cov, log_weight in zip(
                self._log_parameters, self._state, self._cov, self._log_weight, strict=True
            ):
                _process_sample(log, state, cov, log_weight, self._previous_sample, sample, self._tuning.noise)
            self._previous_sample = sample
            for tissue in range(len(self._log_parameters)):
                self._resample(tissue)

    def _resample(self, tissue: int) -> None:
        """Move the weights' sum into the tissue's evidence, and resample the particles if the weights degenerate."""
        log_weight = self._log_weight[tissue]
        total = float(np.logaddexp.reduce(log_weight))
        if not math.isfinite(total):
            return
        self._log_evidence[tissue] += total
        log_weight -= total
        weight = np.exp(log_weight)
        if 1.0 / np.sum(weight**2) > MIN_EFFECTIVE_SHARE * PARTICLES_PER_TISSUE:
            return
        log = self._log_parameters[tissue]
        centre = weight @ log
        scatter = np.sqrt(weight @ (log - centre) ** 2)
        places = (np.arange(PARTICLES_PER_TISSUE) + self._rng.random()) / PARTICLES_PER_TISSUE
        chosen = np.minimum(np.searchsorted(np.cumsum(weight), places), PARTICLES_PER_TISSUE - 1)
        jitter = math.sqrt(1 - KERNEL_SHRINKAGE**2) * scatter * self._rng.standard_normal(log.shape)
        self._log_parameters[tissue] = KERNEL_SHRINKAGE * log[chosen] + (1 - KERNEL_SHRINKAGE) * centre + jitter
        self._state[tissue], self._cov[tissue] = self._state[tissue][chosen], self._cov[tissue][chosen]
        log_weight[:] = -math.log(PARTICLES_PER_TISSUE)

    def probabilities(self) -> np.ndarray:
        weight = self._log_prior + self._log_evidence
        weight = np.exp(weight - weight.max())
        return weight / weight.sum()

    def log_parameters(self) -> np.ndarray:
        tissue = int(np.argmax(self._log_prior + self._log_evidence))
        return np.exp(self._log_weight[tissue]) @ self._log_parameters[tissue, :, :3]


@compiled
def _process_sample(
    log: np.ndarray,
    state: np.ndarray,
    cov: np.ndarray,
    log_weight: np.ndarray,
    before: np.ndarray,
    sample: np.ndarray,
    noise: FilterNoise,
) -> None:
    """Process one sample for all particles of a tissue."""
    step, move, gain = np.empty((2, 4)), np.zeros((4, 4)), np.empty(4)
    move[2, 2] = 1.0
    for k in range(len(log)):
        alpha, beta, damping, mass = math.exp(log[k, 0]), math.exp(log[k, 1]), math.exp(log[k, 2]), math.exp(log[k, 3])
        x, v = state[k, 0], state[k, 1]
        stiffness = tangent_stiffness(alpha, beta, x)
        step_matrices(mass, stiffness, damping, sample[ELAPSED_S], step)
        noise_n = before[NEWTON_PER_VOLT] * state[k, 3]
        held = before[FORCE] - noise_n - elastic_force(alpha, beta, x) + stiffness * x
        rise = sample[FORCE] - before[FORCE] + noise_n
        for r in range(2):
            state[k, r] = step[r, 0] * x + step[r, 1] * v + step[r, 2] * held + step[r, 3] * rise
            move[r, 0], move[r, 1] = step[r, 0], step[r, 1]
            move[r, 3] = -before[NEWTON_PER_VOLT] * (step[r, 2] - step[r, 3])
        state[k, 3] = 0.0
        cov[k] = move @ cov[k] @ move.T
        for r in range(2):
            for q in range(2):
                fresh = sample[NEWTON_PER_VOLT] * sample[NEWTON_PER_VOLT] * step[r, 3] * step[q, 3] * noise.strain_var
                cov[k, r, q] += fresh + step[r, 2] * step[q, 2] * noise.force_var
            cov[k, r, 3] = cov[k, 3, r] = -sample[NEWTON_PER_VOLT] * step[r, 3] * noise.strain_var
        cov[k, 3, 3] = noise.strain_var
        for j in range(4):
            gain[j] = cov[k, j, 0] + cov[k, j, 2] + sample[METRE_PER_VOLT] * cov[k, j, 3]
        variance = gain[0] + gain[2] + sample[METRE_PER_VOLT] * gain[3] + noise.displacement_var
        innovation = sample[DISPLACEMENT] - state[k, 0] - state[k, 2]
        log_weight[k] -= 0.5 * (innovation * innovation / variance + math.log(2.0 * math.pi * variance))
        if not math.isfinite(log_weight[k]):
            log_weight[k] = -np.inf
            continue
        for j in range(4):
            state[k, j] += gain[j] * innovation / variance
        for j in range(4):
            for q in range(4):
                cov[k, j, q] -= gain[j] * gain[q] / variance
