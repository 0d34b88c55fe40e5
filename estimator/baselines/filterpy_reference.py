"""The classes of the same bank on filterpy: a slow, independent reference for the compiled bank.

Both share only the constants, the order of the states and the start of a grasp. The reference discretizes the whole
linearized system with scipy's matrix exponential and uses filterpy's filter equations.
"""

from copy import deepcopy

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag, expm

from config.schema import IdentificationSettings, TissueLibrary, Tool
from estimator.baselines.identifier import BankIdentifier
from estimator.constants import (
    DRIFT_FLOOR_N,
    EXPONENT_LIMIT,
    MAX_INFLATION,
    MAX_LOG_DEVIATION,
    MIN_RISE_N,
    MIN_RISE_SHARE,
    NIS_DIVERGED,
    NIS_INFLATION_THRESHOLD,
    NIS_MEMORY,
    RISE_MEAN_SAMPLES,
    RISE_SPAN_SAMPLES,
    SURPRISE_MIN_SAMPLES,
)
from estimator.evidence import BankEvidence
from estimator.filter_bank import ContactStart, FilterBank
from estimator.kalman_filter import (
    DRIFT,
    INFLATION,
    LOG_LIKELIHOOD,
    NIS_RECENT,
    NIS_SUM,
    OFFSET,
    PARAMETERS,
    PARAMETERS_AND_MASS,
    STATE_COUNT,
    STRAIN_NOISE,
    FilterNoise,
    V,
    X,
    find_likeliest_filter,
)

# further states of the augmented system: strain noise of the next sample, force between the samples, constant
NEXT_STRAIN, FORCE, ONE = range(STATE_COUNT, STATE_COUNT + 3)


class ReferenceFilter(ExtendedKalmanFilter):
    """One filter. Samples, (5,): force N, displacement m, change of each per volt of strain noise, elapsed time s."""

    def __init__(self, mean: np.ndarray, cov: np.ndarray, noise: FilterNoise, guess: np.ndarray) -> None:
        super().__init__(dim_x=STATE_COUNT, dim_z=1)
        self.x, self.P = mean.reshape(-1, 1).copy(), cov.copy()
        self.R = np.array([[noise.displacement_var]])
        self._noise, self._guess = noise, guess
        self.fit_statistics = np.ones(4)  # as those of the bank
        self.fit_statistics[[LOG_LIKELIHOOD, NIS_SUM]] = 0.0

    def process_sample(
        self, before: np.ndarray, sample: np.ndarray, is_rising: bool, linearization_point: np.ndarray | None = None
    ) -> None:
        """Predict from the sample `before`, (5,), to `sample`, (5,), and correct.

        `linearization_point`: log alpha, beta, d and m, (4,); None for the present estimate.
        """
        self._linearize(
            before,
            sample,
            self.x[PARAMETERS_AND_MASS, 0].copy() if linearization_point is None else linearization_point,
        )
        self.predict()
        self._correct(sample, is_rising or self._noise.learns_held > 0)

    @property
    def log_likelihood_sum(self) -> float:
        return float(self.fit_statistics[LOG_LIKELIHOOD])

    def predict_x(self, u: np.ndarray | float = 0) -> None:
        self.x = self._predicted

    def _linearize(self, before: np.ndarray, sample: np.ndarray, linearization_point: np.ndarray) -> None:
        """Compute a step's transition, noise and predicted mean from one matrix exponential of the whole system."""
        noise, dt_s, state = self._noise, float(sample[4]), self.x[:, 0]
        alpha, beta, damping, mass = np.exp(linearization_point)
        bent = np.exp(min(beta * max(state[X], 0.0), EXPONENT_LIMIT))
        elastic = alpha * (bent - 1.0) if state[X] > 0 else alpha * beta * state[X]
        stiffness, damped = alpha * beta * bent, damping * state[V]
        inertial = before[0] - before[2] * state[STRAIN_NOISE] - state[DRIFT] - elastic - damped
        by_parameters = np.array([-elastic, -stiffness * state[X], -damped, -inertial])

        rate = np.zeros((STATE_COUNT + 3, STATE_COUNT + 3))
        rate[X, V], rate[X, ONE] = 1.0, state[V]
        rate[V, [X, V, DRIFT, FORCE]] = -stiffness, -damping, -1.0, 1.0
        rate[V, PARAMETERS_AND_MASS] = by_parameters
        rate[V, ONE] = inertial + by_parameters @ (state[PARAMETERS_AND_MASS] - linearization_point)
        rate[V] /= mass
        rate[FORCE, STRAIN_NOISE], rate[FORCE, NEXT_STRAIN] = before[2] / dt_s, -sample[2] / dt_s
        rate[FORCE, ONE] = (sample[0] - before[0] + before[2] * state[STRAIN_NOISE]) / dt_s
        begin = np.eye(STATE_COUNT + 3)
        begin[FORCE, STRAIN_NOISE] = -before[2]
        step = expm(rate * dt_s) @ begin

        self._predicted = self.x + step[:STATE_COUNT, [ONE]]
        self._predicted[STRAIN_NOISE] = 0.0
        self.F = step[:STATE_COUNT, :STATE_COUNT].copy()
        self.F[STRAIN_NOISE] = 0.0
        fresh = step[:STATE_COUNT, NEXT_STRAIN].copy()
        fresh[STRAIN_NOISE] = 1.0
        held = step[:STATE_COUNT, FORCE]
        walk = [noise.walk_alpha, noise.walk_beta, noise.walk_damping]
        drift = noise.drift_rate * dt_s * (sample[0] ** 2 + DRIFT_FLOOR_N**2)
        force_var = noise.force_var + noise.dynamic_share**2 * (damped**2 + inertial**2)
        self.Q = np.outer(fresh, fresh) * noise.strain_var + np.outer(held, held) * force_var
        self.Q += block_diag(np.zeros((2, 2)), np.diag(walk), np.zeros((2, 2)), drift, 0.0)

    def _correct(self, sample: np.ndarray, learns_parameters: bool) -> None:
        """Do the measurement update and add to the fit statistics; parameters that do not learn have no gain."""
        row = np.zeros((1, STATE_COUNT))
        row[0, [X, OFFSET, STRAIN_NOISE]] = 1.0, 1.0, sample[3]
        variance = float((row @ self.P @ row.T + self.R)[0, 0])
        innovation = sample[1] - float((row @ self.x)[0, 0])
        nis, fit = innovation**2 / variance, self.fit_statistics
        fit[LOG_LIKELIHOOD] -= 0.5 * (nis + np.log(2 * np.pi * variance))
        fit[NIS_SUM] += nis
        fit[NIS_RECENT] = NIS_MEMORY * fit[NIS_RECENT] + (1 - NIS_MEMORY) * nis
        if learns_parameters:
            inflation = np.clip(nis / NIS_INFLATION_THRESHOLD, 1.0, MAX_INFLATION)
            fit[INFLATION] *= inflation
            wider = np.full(STATE_COUNT, np.sqrt(inflation))
            wider[STRAIN_NOISE] = 1.0
            self.P = self.P * np.outer(wider, wider)
            self.update(np.array([[sample[1]]]), HJacobian=lambda _: row, Hx=lambda state: row @ state)
        else:
            gain = self.P @ row.T / variance
            gain[PARAMETERS_AND_MASS] = 0.0
            left = np.eye(STATE_COUNT) - gain @ row
            self.x = self.x + gain * innovation
            self.P = left @ self.P @ left.T + gain @ self.R @ gain.T

    @property
    def is_healthy(self) -> bool:
        state = self.x[:, 0]
        near = np.abs(state[PARAMETERS] - self._guess) <= MAX_LOG_DEVIATION
        finite = np.isfinite(state).all() and np.isfinite(self.P).all()
        return bool(finite and near.all() and np.exp(state[PARAMETERS][1]) * state[X] < EXPONENT_LIMIT)


class ReferenceBank:
    """All K filters of a started `FilterBank`, on filterpy."""

    def __init__(self, started: FilterBank) -> None:
        tissues = len(started.priors.names)
        self.processed_samples, self.rising_flags = [started.first_sample], [True]
        self.filters = [
            ReferenceFilter(*started.initial_state(k), started.priors.mean[k % tissues])
            for k in range(len(started.state.mean))
        ]
        self._initial_filters = deepcopy(self.filters)
        self._second_pass_at = [tuning.second_pass_at for tuning in started.tunings for _ in range(tissues)]

    def advance(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Process `samples`, (n, 5); return means and variances of all filters, (n, K, 9) each; NaN once diverged."""
        shape = (len(samples), len(self.filters), STATE_COUNT)
        means, variances = np.full(shape, np.nan), np.full(shape, np.nan)
        for i, sample in enumerate(samples):
            self.processed_samples.append(sample)
            self.rising_flags.append(self._is_force_rising())
            for k, one in enumerate(self.filters):
                if one.is_healthy:
                    one.process_sample(self.processed_samples[-2], sample, self.rising_flags[-1])
                if one.is_healthy and len(self.processed_samples) in self._second_pass_at[k]:
                    one = self.filters[k] = self._repeat_pass(k)
                if one.is_healthy:
                    means[i, k], variances[i, k] = one.x[:, 0], np.diag(one.P)
        return means, variances

    def _is_force_rising(self) -> bool:
        force = np.array(self.processed_samples)[-RISE_SPAN_SAMPLES - RISE_MEAN_SAMPLES :, 0]
        if len(self.processed_samples) <= RISE_SPAN_SAMPLES + RISE_MEAN_SAMPLES + 1:
            return True
        change = force[-RISE_MEAN_SAMPLES:].mean() - force[:RISE_MEAN_SAMPLES].mean()
        return bool(change > max(MIN_RISE_N, MIN_RISE_SHARE * force[-1]))

    def _repeat_pass(self, k: int) -> ReferenceFilter:
        """Return filter k after another pass over the whole grasp; the present filter if that pass diverges."""
        again, about = deepcopy(self._initial_filters[k]), self.filters[k].x[PARAMETERS_AND_MASS, 0].copy()
        for i in range(1, len(self.processed_samples)):
            again.process_sample(self.processed_samples[i - 1], self.processed_samples[i], self.rising_flags[i], about)
            if not again.is_healthy:
                return self.filters[k]
        return again


class FilterpyBank(FilterBank):
    """The bank, with filterpy's filters in the place of the compiled ones."""

    def start(self, first: ContactStart, strain_var: float | None = None) -> None:
        super().start(first, strain_var)
        self._reference = ReferenceBank(self)

    def advance(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Advance all K filters; return their means and variances, (n, K, 9) each."""
        state, tissues = self.state, len(self.priors.names)
        mean, variance = np.empty((2, len(samples), len(state.mean), STATE_COUNT))
        for i in range(len(samples)):
            with np.errstate(all="ignore"):  # a filter that diverges overflows
                mean[i : i + 1], variance[i : i + 1] = self._reference.advance(samples[i : i + 1])
            for k, one in enumerate(self._reference.filters):
                state.mean[k], state.cov[k] = one.x[:, 0], one.P
                state.fit_statistics[k], state.valid[k] = one.fit_statistics, one.is_healthy
            state.samples_taken[0] += 1
            if state.samples_taken[0] > SURPRISE_MIN_SAMPLES:
                best = find_likeliest_filter(
                    len(state.mean) - tissues, len(state.mean), state.fit_statistics, state.valid
                )
                misfit = state.fit_statistics[best, NIS_RECENT] if best >= 0 else NIS_DIVERGED
                state.surprise[0] = max(state.surprise[0], misfit)
        return mean, variance


def build_filterpy_identifier(tool: Tool, library: TissueLibrary, settings: IdentificationSettings) -> BankIdentifier:
    """Create the bank on filterpy for a library's tissues on a tool."""
    bank = FilterpyBank.from_tool(tool, library)
    return BankIdentifier(bank, BankEvidence(bank, library, settings), 1.0 / tool.board.sample_rate_hz)
