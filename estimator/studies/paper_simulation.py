"""Functions that repeat the paper's simulation: tissues of Table II under a raised cosine of force, noisy signals."""

from dataclasses import dataclass

import numpy as np

from acquisition.compilation import compiled
from acquisition.signals.low_pass import LowPassFilter
from acquisition.simulation.tissue import Material, integrate_tissue
from config.load import load_grasp_protocol
from config.schema import ConditioningSettings, SineWaveform, TissueProfile
from estimator.baselines.paper_filter import PaperFilterBank, PaperNoise
from estimator.criteria import convergence_samples
from estimator.filter_bank import ContactStart, FilterBank, FilterTuning, TissuePriors
from estimator.kalman_filter import PARAMETERS, PARAMETERS_AND_MASS, STATE_COUNT, FilterNoise
from estimator.studies.posterior_mode import PosteriorProblem
from estimator.tissue_model import elastic_force, step_matrices, tangent_stiffness

RATE_HZ = 1000.0
NOISE_SHARE = 0.025  # half the width of the uniform noise, as a share of each signal's peak
ERROR_SHARE = 0.15  # share of the largest force: the paper's bound of convergence
GUESS_FACTOR = 2.0  # guesses are wrong by up to this factor, uniformly in the logarithm
FORCE_CURVATURE_N2_PER_S3 = 400.0  # second derivative of 1 N at 4 Hz, up to 632 N/s², squared, times a sample's 1 ms
GUESS_LOG_SD = np.log(GUESS_FACTOR) / np.sqrt(3)


@dataclass(frozen=True, slots=True)
class SineRun:
    """Noisy and exact force N and displacement m, (n,) each, and the noise's standard deviations."""

    force_n: np.ndarray
    displacement_m: np.ndarray
    exact_force_n: np.ndarray
    exact_displacement_m: np.ndarray
    force_sd_n: float
    displacement_sd_m: float

    @property
    def convergence_bound_n(self) -> float:
        """Largest force error of a filter that has converged, N."""
        return ERROR_SHARE * float(self.exact_force_n.max())


def compute_log_parameters(profile: TissueProfile) -> np.ndarray:
    """Return log alpha, log beta, log d, (3,)."""
    return np.log([profile.alpha_n, profile.beta_per_m, profile.damping_kg_per_s])


def simulate_sine(profile: TissueProfile, mass_kg: float, seed: int) -> SineRun:
    """Simulate the protocol `sine` as force on the tissue itself, without tool and kinematics."""
    waveform = load_grasp_protocol("sine").waveform
    assert isinstance(waveform, SineWaveform)
    time_s = np.arange(round(waveform.grasp_s * RATE_HZ)) / RATE_HZ
    first_s = 1.0 / waveform.first_hz
    cycles = np.where(time_s < first_s, time_s * waveform.first_hz, (time_s - first_s) * waveform.then_hz)
    force_n = waveform.peak_n / 2 * (1 - np.cos(2 * np.pi * cycles))
    material = Material(profile.alpha_n, profile.beta_per_m, profile.damping_kg_per_s, mass_kg)
    x_m = np.zeros(len(force_n))
    v, relaxed = 0.0, 0.0
    for i in range(1, len(force_n)):
        x_m[i], v, relaxed = integrate_tissue(
            x_m[i - 1], v, relaxed, force_n[i - 1], force_n[i], 1 / RATE_HZ, 0.0, material
        )
    random = np.random.default_rng([seed, 3])
    width_n, width_m = NOISE_SHARE * force_n.max(), NOISE_SHARE * x_m.max()
    return SineRun(
        force_n + random.uniform(-width_n, width_n, len(force_n)),
        x_m + random.uniform(-width_m, width_m, len(x_m)),
        force_n,
        x_m,
        float(width_n / np.sqrt(3)),
        float(width_m / np.sqrt(3)),
    )


def draw_guesses(profile: TissueProfile, seed: int) -> np.ndarray:
    """Draw wrong guesses of alpha, beta and d, (3,), each within a factor of two of the truth."""
    off = np.random.default_rng([seed, 4]).uniform(-1, 1, 3) * np.log(GUESS_FACTOR)
    return np.exp(compute_log_parameters(profile) + off)


def build_filter_noise(run: SineRun) -> FilterNoise:
    """Return our filters' noise model of a run: independent noise on force and displacement, tissue exactly Eq. (7)."""
    return FilterNoise(
        strain_var=run.force_sd_n**2,
        force_var=1e-8,
        displacement_var=run.displacement_sd_m**2,
        walk_alpha=0.0,
        walk_beta=0.0,
        walk_damping=0.0,
        dynamic_share=0.0,
        drift_rate=0.0,
        learns_held=1.0,
    )


def build_filter_bank(priors: TissuePriors, run: SineRun, widening: float = 1.0) -> FilterBank:
    """Create our filters for a run; the mass is known."""
    return FilterBank(priors, (FilterTuning(build_filter_noise(run), 0.0),), widening)


def build_bank_inputs(run: SineRun) -> tuple[ContactStart, np.ndarray]:
    """Convert a simulated run to the filter bank's inputs: start of contact, and the samples after the first, (n, 5).

    The columns are force, N, displacement, m, newtons per volt, meters per volt, and step, s. The simulation has no
    strain gage, so its force counts as a strain with 1 N per volt.
    """
    ones, zeros = np.ones(len(run.force_n)), np.zeros(len(run.force_n))
    samples = np.column_stack([run.force_n, run.displacement_m - run.displacement_m[0], ones, zeros, ones / RATE_HZ])
    return ContactStart(samples[0], initial_compression_m=0.0, initial_compression_sd_m=1e-12), samples[1:]


def run_paper_filters(
    run: SineRun, guess: np.ndarray, mass_kg: float, conditioning: ConditioningSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run the paper's filters from guesses (K, 3) on the 10 Hz signals.

    Returns:
        Means (n, K, 5), elastic forces (n, K) and filtered force (n,).
    """
    force_n, displacement_m = LowPassFilter(conditioning, RATE_HZ)(np.stack([run.force_n, run.displacement_m]))
    share = compute_noise_share(conditioning)
    noise = PaperNoise(share * run.force_sd_n, share * run.displacement_sd_m)
    bank = PaperFilterBank(guess, mass_kg, 1 / RATE_HZ, noise, guess_share_sd=np.full(3, GUESS_LOG_SD))
    bank.start(float(force_n[0]))
    means, elastic_n = bank.advance(force_n[1:], displacement_m[1:])
    return means, elastic_n, force_n[1:]


def compute_noise_share(conditioning: ConditioningSettings) -> float:
    """Return the share of white noise after the low-pass; its noise bandwidth is 1.11 times the cut-off."""
    return float(np.sqrt(2 * 1.11 * conditioning.butterworth_cutoff_hz / RATE_HZ))


def convergence_s(elastic_n: np.ndarray, force_n: np.ndarray, bound_n: float) -> float:
    """Return the time, s, from which the elastic force differs from the force by at most `bound_n`; NaN if none."""
    return float(convergence_samples((elastic_n - force_n)[:, None], bound_n)[0]) / RATE_HZ


class TwoSignalProblem(PosteriorProblem):
    """A run's force and displacement as two independent measurements of one motion.

    The live filters take the measured force as input. That is right on a grasper, where the displacement shows the
    strain gage's noise sample by sample. Here both noises are independent. A filter that took the force's noise for
    force would find too large a damping. So the force is a state, as smooth as the protocol's.
    """

    @classmethod
    def from_run(cls, run: SineRun, log_prior: np.ndarray, log_sd: np.ndarray, mass_kg: float) -> "TwoSignalProblem":
        """Create the problem from mean and SD of log alpha, log beta and log d, (3,) each; the mass is known."""
        mean, cov = np.zeros(STATE_COUNT), np.zeros((STATE_COUNT, STATE_COUNT))
        mean[PARAMETERS_AND_MASS] = [*log_prior, np.log(mass_kg)]
        cov[PARAMETERS, PARAMETERS] = np.diag(log_sd**2)
        return cls(mean, cov, np.column_stack([run.force_n, run.displacement_m]), build_filter_noise(run))

    def innovations(self, log_parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _compute_two_signal_innovations(
            np.exp(log_parameters), self.samples, self.noise, FORCE_CURVATURE_N2_PER_S3
        )


@compiled
def _compute_two_signal_innovations(
    parameters: np.ndarray, samples: np.ndarray, noise: FilterNoise, bend: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return innovations and variances of force and displacement in turn, (2 n,) each; state: x, x', force, rate."""
    alpha, beta, damping, mass = parameters
    dt = 1.0 / RATE_HZ
    found, variances = np.empty(2 * len(samples)), np.empty(2 * len(samples))
    mean, cov, step, move = np.zeros(4), np.zeros((4, 4)), np.empty((2, 4)), np.eye(4)
    cov[3, 3] = 1.0  # N²/s²: how fast the force may begin to rise
    move[2, 3] = dt
    for i in range(len(samples)):
        if i > 0:
            x = mean[0]
            stiffness = tangent_stiffness(alpha, beta, x)
            step_matrices(mass, stiffness, damping, dt, step)
            for r in range(2):
                move[r, 0], move[r, 1], move[r, 2], move[r, 3] = step[r, 0], step[r, 1], step[r, 2], step[r, 3] * dt
            mean = move @ mean
            mean[:2] += step[:, 2] * (stiffness * x - elastic_force(alpha, beta, x))
            cov = move @ cov @ move.T
            cov[2, 2] += bend * dt**3 / 3
            cov[2, 3] += bend * dt**2 / 2
            cov[3, 2] += bend * dt**2 / 2
            cov[3, 3] += bend * dt
        for which in range(2):
            row, variance = (2, noise.strain_var) if which == 0 else (0, noise.displacement_var)
            variances[2 * i + which] = cov[row, row] + variance
            found[2 * i + which] = samples[i, which] - mean[row]
            gain = cov[:, row] / variances[2 * i + which]
            mean = mean + gain * found[2 * i + which]
            cov = cov - gain.reshape(-1, 1) * gain * variances[2 * i + which]
    return found, variances
