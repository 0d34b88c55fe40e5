"""The bank: extended Kalman filters for every tissue of the library, all on the same grasp."""

import math
from dataclasses import dataclass

import numpy as np

from config.schema import TissueLibrary, Tool, ToolKind
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
    SECOND_PASS_AT,
    STRICT_DYNAMIC_SHARE,
    STRICT_LOG_MASS_SD,
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
    """Per tissue: mean and SD of (log alpha, log beta, log d), each of shape (tissues, 3).

    `correlation`, (tissues, 3, 3), where the library was learned: what is stiff is seldom soft at first as well.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    sd: np.ndarray
    mass_kg: float
    correlation: np.ndarray | None = None

    @classmethod
    def from_library(cls, library: TissueLibrary) -> "TissuePriors":
        mean = [(t.alpha_n, t.beta_per_m, t.damping_kg_per_s) for t in library.tissues.values()]
        spreads = [library.spread_of(name) for name in library.tissues]
        sd = [(s.log_alpha, s.log_beta, s.log_damping) for s in spreads]
        learned = [np.array(t.learned.log_covariance)[:3, :3] for t in library.tissues.values() if t.learned]
        each_sd = [np.sqrt(np.diag(cov)) for cov in learned]
        correlation = np.array([cov / np.outer(s, s) for cov, s in zip(learned, each_sd, strict=True)])
        return cls(
            tuple(library.tissues), np.log(mean), np.array(sd), library.mass_kg, correlation if learned else None
        )


@dataclass(frozen=True, slots=True)
class FilterTuning:
    """How far one kind of filter trusts sensors and model."""

    noise: FilterNoise
    log_mass_sd: float


def build_filter_tunings(tool: Tool) -> tuple[FilterTuning, FilterTuning]:
    """The two kinds of filter on a tool: its strain noise, and this package's constants."""
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


def tune_for_real_tissue(trust: FilterTuning) -> FilterTuning:
    """The same kind of filter for real tissue: it sticks, slides and leaves its curve, and cable and drive rub."""
    noise = trust.noise._replace(
        force_var=REAL_FORCE_SD_N**2,
        displacement_var=REAL_DISPLACEMENT_SD_M**2,
        dynamic_share=REAL_DYNAMIC_SHARE,
        drift_rate=REAL_DRIFT_RATE,
    )
    return FilterTuning(noise, LENIENT_LOG_MASS_SD)


@dataclass(slots=True)
class BankState:
    """What the filters know after `taken` samples; K filters: all tissues with the first trust, then with the next."""

    mean: np.ndarray  # (K, 9)
    cov: np.ndarray  # (K, 9, 9)
    fit_statistics: (
        np.ndarray
    )  # (K, 4): log-likelihood, sum and running mean of the normalised innovations squared, widening
    valid: np.ndarray  # (K,) bool; False once diverged
    samples_taken: np.ndarray  # (1,) samples of the grasp, the first included
    surprise: np.ndarray  # (1,) how badly even the best lenient filter has ever fitted lately; 1 where all is right

    def copy(self) -> "BankState":
        return BankState(*(getattr(self, name).copy() for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class ContactStart:
    """A grasp's first sample in contact, where the displacement counts from.

    `past_m` is how far the tissue has been pressed by then. `unfelt_force_n` may press before contact is felt; 0 where
    a sensor tells.
    """

    sample: np.ndarray  # (5,): as `Bank.advance` takes them
    velocity_m_per_s: float = 0.0
    undetected_force_n: float = 0.0
    initial_compression_m: float = INITIAL_COMPRESSION_M
    initial_compression_sd_m: float = INITIAL_COMPRESSION_SD_M


class FilterBank:
    """A filter of each kind of trust for each tissue, on one grasp's force and displacement."""

    def __init__(
        self, priors: TissuePriors, trusts: tuple[FilterTuning, ...], widening: float = PRIOR_SD_FACTOR
    ) -> None:
        self.priors, self.tunings = priors, trusts
        self.filter_sd = priors.sd * widening
        self._guess = np.tile(priors.mean, (len(trusts), 1))
        self._history = np.zeros((int(SECOND_PASS_AT[-1]), SAMPLE_COLUMNS + 1))
        self.start(ContactStart(np.zeros(SAMPLE_COLUMNS)))

    @classmethod
    def from_tool(cls, tool: Tool, library: TissueLibrary) -> "FilterBank":
        """The bank for a library's tissues on a tool."""
        trusts = build_filter_tunings(tool)
        if library.learned and tool.kind is not ToolKind.SIMULATED:
            trusts = tuple(tune_for_real_tissue(trust) for trust in trusts)
        return cls(TissuePriors.from_library(library), trusts)

    def start(self, first: ContactStart, strain_var: float | None = None) -> None:
        """Begin a grasp at its first sample in contact; `strain_var`, V², where it has been measured.

        Sensed contact happened a little before. Contact found from the force lies back by what each tissue needs to
        make itself felt. Either way x + offset + strain noise is the measured zero.
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
        """How filter k began the grasp: its state's mean, (9,), and covariance, (9, 9), and its noise."""
        noise = self._noises[k // len(self.priors.names)]
        return self._initial_mean[k].copy(), self._initial_cov[k].copy(), noise

    @property
    def first_sample(self) -> np.ndarray:
        """The grasp's first sample in contact as the filters took it, (5,)."""
        return self._first_sample.copy()

    def find_most_likely(self) -> int:
        """The filter that the data make likeliest; -1 where all have diverged or lost the data."""
        state = self.state
        followed = [k for k in range(len(state.mean)) if is_tracking(k, state.fit_statistics, state.valid)]
        return max(followed, key=lambda k: state.fit_statistics[k, LOG_LIKELIHOOD], default=-1)

    def compute_mean_nis(self) -> np.ndarray:
        """Mean normalised innovation squared of each filter over the grasp, (K,): 1 where all is right."""
        return self.state.fit_statistics[:, NIS_SUM] / max(int(self.state.samples_taken[0]) - 1, 1)

    def advance(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take the samples after the first: force N, displacement m, what a volt of strain noise does to each, and the
        time since the sample before, s; shape (n, 5).

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
            SECOND_PASS_AT,
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


def build_contact_start(first: np.void, velocity_m_per_s: float, *, contact_sensed: bool) -> ContactStart:
    """How a grasp starts for the filters, from its first sample and how fast the jaws came."""
    sample = np.array([*(first[name] for name in BANK_COLUMNS), 0.0])
    return ContactStart(sample) if contact_sensed else ContactStart(sample, velocity_m_per_s, UNDETECTED_FORCE_N)


def bank_columns(samples: np.ndarray, contact_m: float, tick_before: int, dt_s: float) -> np.ndarray:
    """What the bank takes of samples of dtype SAMPLE, (n, 5): displacement counts from contact, time from each other.

    `tick_before`: of the sample before them, which may lie further back than one: a gap is a longer step.
    """
    elapsed_s = np.diff(samples["tick"], prepend=tick_before) * dt_s
    columns = np.column_stack([*(samples[name] for name in BANK_COLUMNS), elapsed_s])
    columns[:, 1] -= contact_m
    return columns
