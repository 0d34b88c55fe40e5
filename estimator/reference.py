"""The same bank on filterpy: slow, independent, for checking the compiled one.

Shared with it are only the constants, the order of the states and the start of a grasp; the discretisation (scipy's
matrix exponential of the whole linearised system) and the filter equations (filterpy's) are others.
"""

from copy import deepcopy

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag, expm

from estimator.bank import Bank
from estimator.constants import (
    DRIFT_FLOOR_N,
    EXPONENT_LIMIT,
    LOG_RANGE,
    NIS_SURPRISING,
    RISING_LEAST_N,
    RISING_MEAN,
    RISING_SHARE,
    RISING_SPAN,
    SECOND_PASS_AT,
    WIDENING_MOST,
)
from estimator.filter import ABOUT, DRIFT, OFFSET, PARAMETERS, STATES, STRAIN, Noise, V, X

NEXT_STRAIN, FORCE, ONE = range(STATES, STATES + 3)  # of the augmented system: strain noise of the sample to come,
# force between the samples, constant


class ReferenceFilter(ExtendedKalmanFilter):
    """One filter. Samples are [force N, displacement m, and what a volt of strain noise does to each]."""

    def __init__(self, mean: np.ndarray, cov: np.ndarray, noise: Noise, guess: np.ndarray) -> None:
        super().__init__(dim_x=STATES, dim_z=1)
        self.x, self.P = mean.reshape(-1, 1).copy(), cov.copy()
        self.R = np.array([[noise.displacement_var]])
        self._noise, self._guess = noise, guess
        self.log_likelihood_sum = 0.0

    def take(self, before: np.ndarray, sample: np.ndarray, rising: bool, about: np.ndarray | None = None) -> None:
        """Predict from the sample `before`, (5,), to `sample`, (5,), linearised `about` log parameters, and correct."""
        self._linearise(before, sample, self.x[ABOUT, 0].copy() if about is None else about)
        self.predict()
        self._correct(sample, rising or self._noise.learns_held > 0)

    def predict_x(self, u=0) -> None:
        self.x = self._predicted

    def _linearise(self, before: np.ndarray, sample: np.ndarray, about: np.ndarray) -> None:
        """Transition, noise and predicted mean of a step: the whole system of deviations, exponentiated at once."""
        noise, dt_s, state = self._noise, float(sample[4]), self.x[:, 0]
        alpha, beta, damping, mass = np.exp(about)
        bent = np.exp(min(beta * max(state[X], 0.0), EXPONENT_LIMIT))
        elastic = alpha * (bent - 1.0) if state[X] > 0 else alpha * beta * state[X]
        stiffness, damped = alpha * beta * bent, damping * state[V]
        inertial = before[0] - before[2] * state[STRAIN] - state[DRIFT] - elastic - damped
        by_parameters = np.array([-elastic, -stiffness * state[X], -damped, -inertial])

        rate = np.zeros((STATES + 3, STATES + 3))
        rate[X, V], rate[X, ONE] = 1.0, state[V]
        rate[V, [X, V, DRIFT, FORCE]] = -stiffness, -damping, -1.0, 1.0
        rate[V, ABOUT] = by_parameters
        rate[V, ONE] = inertial + by_parameters @ (state[ABOUT] - about)
        rate[V] /= mass
        rate[FORCE, STRAIN], rate[FORCE, NEXT_STRAIN] = before[2] / dt_s, -sample[2] / dt_s
        rate[FORCE, ONE] = (sample[0] - before[0] + before[2] * state[STRAIN]) / dt_s
        begin = np.eye(STATES + 3)
        begin[FORCE, STRAIN] = -before[2]
        step = expm(rate * dt_s) @ begin

        self._predicted = self.x + step[:STATES, [ONE]]
        self._predicted[STRAIN] = 0.0
        self.F = step[:STATES, :STATES].copy()
        self.F[STRAIN] = 0.0
        fresh = step[:STATES, NEXT_STRAIN].copy()
        fresh[STRAIN] = 1.0
        held = step[:STATES, FORCE]
        walk = [noise.walk_alpha, noise.walk_beta, noise.walk_damping]
        drift = noise.drift_rate * dt_s * (sample[0] ** 2 + DRIFT_FLOOR_N**2)
        force_var = noise.force_var + noise.dynamic_share**2 * (damped**2 + inertial**2)
        self.Q = np.outer(fresh, fresh) * noise.strain_var + np.outer(held, held) * force_var
        self.Q += block_diag(np.zeros((2, 2)), np.diag(walk), np.zeros((2, 2)), drift, 0.0)

    def _correct(self, sample: np.ndarray, learns: bool) -> None:
        """Measurement update, and its log-likelihood; where it does not learn, the parameters' gain is zero."""
        row = np.zeros((1, STATES))
        row[0, [X, OFFSET, STRAIN]] = 1.0, 1.0, sample[3]
        variance = float((row @ self.P @ row.T + self.R)[0, 0])
        innovation = sample[1] - float((row @ self.x)[0, 0])
        self.log_likelihood_sum -= 0.5 * (innovation**2 / variance + np.log(2 * np.pi * variance))
        if learns:
            wider = np.full(STATES, np.sqrt(np.clip(innovation**2 / variance / NIS_SURPRISING, 1.0, WIDENING_MOST)))
            wider[STRAIN] = 1.0
            self.P = self.P * np.outer(wider, wider)
            self.update(np.array([[sample[1]]]), HJacobian=lambda _: row, Hx=lambda state: row @ state)
        else:
            gain = self.P @ row.T / variance
            gain[ABOUT] = 0.0
            left = np.eye(STATES) - gain @ row
            self.x = self.x + gain * innovation
            self.P = left @ self.P @ left.T + gain @ self.R @ gain.T

    @property
    def sound(self) -> bool:
        state = self.x[:, 0]
        near = np.abs(state[PARAMETERS] - self._guess) <= LOG_RANGE
        finite = np.isfinite(state).all() and np.isfinite(self.P).all()
        return bool(finite and near.all() and np.exp(state[PARAMETERS][1]) * state[X] < EXPONENT_LIMIT)


class ReferenceBank:
    """All K filters of a started `Bank`, on filterpy; `rising`: whether the force did at each of `samples`."""

    def __init__(self, started: Bank) -> None:
        tissues = len(started.priors.names)
        self.samples, self.rising = [started.first_sample], [True]
        self.filters = [
            ReferenceFilter(*started.beginning(k), started.priors.mean[k % tissues])
            for k in range(len(started.state.mean))
        ]
        self._first = deepcopy(self.filters)

    def advance(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means and variances of all filters after each of `samples`, (n, 5): (n, K, 9) each; NaN once diverged."""
        shape = (len(samples), len(self.filters), STATES)
        means, variances = np.full(shape, np.nan), np.full(shape, np.nan)
        for i, sample in enumerate(samples):
            self.samples.append(sample)
            self.rising.append(self._rises())
            for k, one in enumerate(self.filters):
                if one.sound:
                    one.take(self.samples[-2], sample, self.rising[-1])
                if one.sound and len(self.samples) in SECOND_PASS_AT:
                    one = self.filters[k] = self._again(k)
                if one.sound:
                    means[i, k], variances[i, k] = one.x[:, 0], np.diag(one.P)
        return means, variances

    def _rises(self) -> bool:
        force = np.array(self.samples)[-RISING_SPAN - RISING_MEAN :, 0]
        if len(self.samples) <= RISING_SPAN + RISING_MEAN + 1:
            return True
        change = force[-RISING_MEAN:].mean() - force[:RISING_MEAN].mean()
        return bool(change > max(RISING_LEAST_N, RISING_SHARE * force[-1]))

    def _again(self, k: int) -> ReferenceFilter:
        """Filter k after another pass over the whole grasp, unless it diverges in it."""
        again, about = deepcopy(self._first[k]), self.filters[k].x[ABOUT, 0].copy()
        for i in range(1, len(self.samples)):
            again.take(self.samples[i - 1], self.samples[i], self.rising[i], about)
            if not again.sound:
                return self.filters[k]
        return again
