"""The class FilterBank: extended Kalman filters for every tissue of the library, side by side on one grasp."""

import math
from dataclasses import dataclass, replace

import numpy as np

from acquisition.compilation import compiled
from config.schema import ForceLaw, TissueLibrary, Tool, ToolKind
from estimator.constants import (
    DISPLACEMENT_NOISE_SD_M,
    FORCE_NOISE_SD_N,
    INITIAL_COMPRESSION_M,
    INITIAL_COMPRESSION_SD_M,
    LENIENT_DRIFT_RATE,
    LENIENT_DYNAMIC_SHARE,
    LENIENT_LOG_MASS_SD,
    LOG_WALK_SD,
    PRIOR_SD_FACTOR,
    REAL_DISPLACEMENT_SD_M,
    REAL_DRIFT_RATE,
    REAL_DYNAMIC_SHARE,
    REAL_FORCE_SD_N,
    REAL_FORCE_SD_V,
    SECOND_PASS_AT,
    STRICT_DYNAMIC_SHARE,
    STRICT_LOG_MASS_SD,
    STRICT_SECOND_PASS_AT,
    UNDETECTED_FORCE_N,
    VELOCITY_SD_M_PER_S,
)
from estimator.kalman_filter import (
    DISPLACEMENT,
    INFLATION,
    LOG_ALPHA,
    LOG_BETA,
    LOG_LIKELIHOOD,
    LOG_MASS,
    NIS_RECENT,
    NIS_SUM,
    OFFSET,
    PARAMETERS,
    STATE_COUNT,
    STRAIN_NOISE,
    FilterNoise,
    V,
    X,
    advance_bank,
    is_tracking,
)

BANK_COLUMNS = ("jaw_force_n", "jaw_displacement_m", "newton_per_volt", "metre_per_volt")
SAMPLE_COLUMNS = 5


@dataclass(frozen=True, slots=True)
class TissuePriors:
    """Prior of each tissue: mean and SD of (log alpha, log beta, log d), each of shape (tissues, 3).

    `correlation`, (tissues, 3, 3), exists for a learned library only.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray
    mass_kg: float
    correlation: np.ndarray | None = None

    @classmethod
    def from_library(cls, library: TissueLibrary) -> "TissuePriors":
        alpha = [library.compute_apparent_alpha(name) for name in library.tissues]
        tissues = zip(alpha, library.tissues.values(), strict=True)
        mean = [(held.median_n, t.beta_per_m, t.damping_kg_per_s) for held, t in tissues]
        spreads = zip(alpha, map(library.spread_of, library.tissues), strict=True)
        sd = [(held.log_sd, s.log_beta, s.log_damping) for held, s in spreads]
        learned = [np.array(t.learned.log_covariance)[:3, :3] for t in library.tissues.values() if t.learned]
        each_sd = [np.sqrt(np.diag(cov)) for cov in learned]
        correlation = np.array([cov / np.outer(s, s) for cov, s in zip(learned, each_sd, strict=True)])
        return cls(
            tuple(library.tissues), np.log(mean), np.array(sd), library.mass_kg, correlation if learned else None
        )


@dataclass(frozen=True, slots=True)
class FilterTuning:
    """Tuning of one kind of filter: noise, SD of the log mass, and the sample counts at which it repeats the grasp."""

    noise: FilterNoise
    log_mass_sd: float
    second_pass_at: tuple[int, ...] = SECOND_PASS_AT


def build_filter_tunings(tool: Tool) -> tuple[FilterTuning, FilterTuning]:
    """Return the tunings of the strict and the lenient filters for a tool's strain noise."""
    strict = FilterNoise(
        strain_var=tool.noise.strain_var_v2,
        force_var=FORCE_NOISE_SD_N**2,
        displacement_var=DISPLACEMENT_NOISE_SD_M**2,
        walk_alpha=LOG_WALK_SD[0] ** 2,
        walk_beta=LOG_WALK_SD[1] ** 2,
        walk_damping=LOG_WALK_SD[2] ** 2,
        dynamic_share=STRICT_DYNAMIC_SHARE,
        drift_rate=0.0,
        learns_held=1.0,
    )
    lenient = strict._replace(dynamic_share=LENIENT_DYNAMIC_SHARE, drift_rate=LENIENT_DRIFT_RATE, learns_held=0.0)
    return FilterTuning(strict, STRICT_LOG_MASS_SD), FilterTuning(lenient, LENIENT_LOG_MASS_SD)


def tune_for_real_tissue(trust: FilterTuning, tool: Tool) -> FilterTuning:
    """Return a filter's tuning with more noise, for real tissue held by `tool`.

    Real tissue sticks, slides and leaves its curve, and cable and drive have friction.
    """
    scale = tool.calibration.jaw_force_scale
    force_sd_n = REAL_FORCE_SD_V * scale.value if scale.law is ForceLaw.CONSTANT else REAL_FORCE_SD_N
    noise = trust.noise._replace(
        force_var=force_sd_n**2,
        displacement_var=REAL_DISPLACEMENT_SD_M**2,
        dynamic_share=REAL_DYNAMIC_SHARE,
        drift_rate=REAL_DRIFT_RATE,
    )
    return replace(trust, noise=noise, log_mass_sd=LENIENT_LOG_MASS_SD)


@dataclass(slots=True)
class BankState:
    """State of all K filters after `samples_taken` samples: all tissues' strict filters, then all lenient ones."""

    mean: np.ndarray  # (K, 9)
    cov: np.ndarray  # (K, 9, 9)
    # (K, 4): log-likelihood, sum and running mean of the normalized innovations squared, covariance inflation
    fit_statistics: np.ndarray
    valid: np.ndarray  # (K,) bool; False once diverged
    samples_taken: np.ndarray  # (1,) samples of the grasp, including the first
    surprise: np.ndarray  # (1,) highest running misfit so far of the best lenient filter; 1 if the model fits

    def copy(self) -> "BankState":
        return BankState(*(getattr(self, name).copy() for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class ContactStart:
    """A grasp's first sample in contact, from which the displacement counts.

    `initial_compression_m` is the compression of the tissue at that sample. `undetected_force_n` is the scale of the
    force that may act before contact is detected; 0 if a touch sensor detects it.
    """

    sample: np.ndarray  # (5,), columns as in `FilterBank.advance`
    velocity_m_per_s: float = 0.0
    undetected_force_n: float = 0.0
    initial_compression_m: float = INITIAL_COMPRESSION_M
    initial_compression_sd_m: float = INITIAL_COMPRESSION_SD_M


class FilterBank:
    """One filter of each kind for each tissue, on the force and displacement of one grasp."""

    def __init__(
        self, priors: TissuePriors, trusts: tuple[FilterTuning, ...], widening: float = PRIOR_SD_FACTOR
    ) -> None:
        self.priors, self.tunings = priors, trusts
        self.filter_sd = priors.sd * widening
        self._guess = np.tile(priors.mean, (len(trusts), 1))
        longest = max(len(trust.second_pass_at) for trust in trusts)
        self.second_pass_at = np.zeros((len(trusts), longest), np.int64)  # 0: no pass
        for row, trust in zip(self.second_pass_at, trusts, strict=True):
            row[: len(trust.second_pass_at)] = trust.second_pass_at
        self._history = np.zeros((int(self.second_pass_at.max()), SAMPLE_COLUMNS + 1))
        self.start(ContactStart(np.zeros(SAMPLE_COLUMNS)))

    @classmethod
    def from_tool(cls, tool: Tool, library: TissueLibrary) -> "FilterBank":
        """Create the bank for a library's tissues on a tool."""
        trusts = build_filter_tunings(tool)
        if library.learned and tool.kind is not ToolKind.SIMULATED:
            trusts = tuple(tune_for_real_tissue(trust, tool) for trust in trusts)
        if library.units is not None:
            trusts = (replace(trusts[0], second_pass_at=STRICT_SECOND_PASS_AT), *trusts[1:])
        return cls(TissuePriors.from_library(library), trusts)

    def start(self, first: ContactStart, strain_var: float | None = None) -> None:
        """Begin a grasp at its first sample in contact.

        `strain_var`, V², is the measured strain noise, None for the tool file's. Contact itself came earlier by a small
        compression. For contact found from the force, the compression that makes each tissue detectable is added. In
        both cases x + offset + strain noise is the measured zero.
        """
        k = len(self._guess)
        mean, cov = np.zeros((k, STATE_COUNT)), np.zeros((k, STATE_COUNT, STATE_COUNT))
        mean[:, PARAMETERS], mean[:, LOG_MASS] = self._guess, math.log(self.priors.mass_kg)
        self._noises = tuple(
            trust.noise if strain_var is None else trust.noise._replace(strain_var=strain_var) for trust in self.tunings
        )
        metre_per_volt = first.sample[3]
        kinds = zip(self._noises, self.tunings, strict=True)
        correlations = [None] * len(self.filter_sd) if self.priors.correlation is None else self.priors.correlation
        own = list(zip(self.filter_sd, correlations, strict=True))
        each = [(noise, trust.log_mass_sd, sd, correlation) for noise, trust in kinds for sd, correlation in own]
        for at, spread, (noise, log_mass_sd, sd, correlation) in zip(mean, cov, each, strict=True):
            unfelt_m = math.log1p(first.undetected_force_n / math.exp(at[LOG_ALPHA])) / math.exp(at[LOG_BETA])
            x_var = first.initial_compression_sd_m**2 + unfelt_m**2
            at[X], at[V] = first.initial_compression_m + 0.5 * unfelt_m, first.velocity_m_per_s
            at[OFFSET] = -at[X]
            variances = [x_var, VELOCITY_SD_M_PER_S**2, *sd**2, log_mass_sd**2, x_var, 0.0, noise.strain_var]
            np.fill_diagonal(spread, variances)
            if correlation is not None:
                spread[PARAMETERS, PARAMETERS] = correlation * np.outer(sd, sd)
            spread[X, OFFSET] = spread[OFFSET, X] = -x_var
            spread[OFFSET, STRAIN_NOISE] = spread[STRAIN_NOISE, OFFSET] = -metre_per_volt * noise.strain_var
            spread[OFFSET, OFFSET] += metre_per_volt**2 * noise.strain_var + noise.displacement_var
        self._initial_mean, self._initial_cov = mean.copy(), cov.copy()
        self._first_sample = first.sample.copy()
        self._first_sample[DISPLACEMENT] = 0.0
        self._history[0] = [*self._first_sample, 1.0]
        fit = np.zeros((k, 4))
        fit[:, [NIS_RECENT, INFLATION]] = 1.0
        self.state = BankState(mean, cov, fit, np.ones(k, bool), np.ones(1, np.int64), np.ones(1))

    def initial_state(self, k: int) -> tuple[np.ndarray, np.ndarray, FilterNoise]:
        """Return filter k's state at the grasp's start, mean (9,) and covariance (9, 9), and its noise."""
        noise = self._noises[k // len(self.priors.names)]
        return self._initial_mean[k].copy(), self._initial_cov[k].copy(), noise

    @property
    def first_sample(self) -> np.ndarray:
        """The grasp's first sample in contact, (5,), with the columns of `advance`; its displacement is 0."""
        return self._first_sample.copy()

    def find_likeliest_filter(self) -> int:
        """Return the index of the filter with the highest likelihood; -1 if all have diverged or lost the data."""
        state = self.state
        followed = [k for k in range(len(state.mean)) if is_tracking(k, state.fit_statistics, state.valid)]
        return max(followed, key=lambda k: state.fit_statistics[k, LOG_LIKELIHOOD], default=-1)

    def compute_mean_nis(self) -> np.ndarray:
        """Return each filter's mean normalized innovation squared over the grasp, (K,); 1 if the model fits."""
        return self.state.fit_statistics[:, NIS_SUM] / max(int(self.state.samples_taken[0]) - 1, 1)

    def compute_recent_nis(self) -> np.ndarray:
        """Return the running mean NIS of each tissue's likelier filter, (M,); NaN once all have diverged."""
        return compute_recent_nis(self.state.fit_statistics, self.state.valid, len(self.priors.names))

    def advance(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Advance all filters over the samples after the first.

        Args:
            samples: (n, 5): force N, displacement m, change of each per volt of strain noise (N/V, m/V), and time since
                the previous sample, s.

        Returns:
            For each of M tissues the means, (n, M, 9), and variances, (n, M, 9), of its likelier filter after each
            sample; NaN where all of its filters have diverged.
        """
        shape = (len(samples), len(self.priors.names), STATE_COUNT)
        mean, variance = np.empty(shape), np.empty(shape)
        s = self.state
        advance_bank(
            samples,
            self._history,
            s.samples_taken,
            self._noises,
            self.second_pass_at,
            self._guess,
            self._initial_mean,
            self._initial_cov,
            s.mean,
            s.cov,
            s.fit_statistics,
            s.valid,
            s.surprise,
            mean,
            variance,
        )
        return mean, variance


@compiled
def compute_recent_nis(fit: np.ndarray, valid: np.ndarray, tissues: int) -> np.ndarray:
    """Return the running mean NIS of each tissue's likeliest filter that has not lost the data, else the lowest."""
    result = np.full(tissues, np.nan)
    for tissue in range(tissues):
        best = -1
        for k in range(tissue, len(fit), tissues):
            if is_tracking(k, fit, valid) and (best < 0 or fit[k, LOG_LIKELIHOOD] > fit[best, LOG_LIKELIHOOD]):
                best = k
            elif best < 0 and valid[k] and not fit[k, NIS_RECENT] > result[tissue]:
                result[tissue] = fit[k, NIS_RECENT]
        if best >= 0:
            result[tissue] = fit[best, NIS_RECENT]
    return result


def build_contact_start(first: np.void, velocity_m_per_s: float, *, contact_sensed: bool) -> ContactStart:
    """Return the filters' start of a grasp, from its first sample in contact and the speed of the closing jaws."""
    sample = np.array([*(first[name] for name in BANK_COLUMNS), 0.0])
    return ContactStart(sample) if contact_sensed else ContactStart(sample, velocity_m_per_s, UNDETECTED_FORCE_N)


def bank_columns(samples: np.ndarray, contact_m: float, tick_before: int, dt_s: float) -> np.ndarray:
    """Return the columns that `FilterBank.advance` takes, (n, 5), from samples of dtype SAMPLE.

    Displacement counts from contact. `tick_before` is the tick of the previous sample; after a gap the first step is
    longer.
    """
    elapsed_s = np.diff(samples["tick"], prepend=tick_before) * dt_s
    columns = np.column_stack([*(samples[name] for name in BANK_COLUMNS), elapsed_s])
    columns[:, 1] -= contact_m
    return columns
