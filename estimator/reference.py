"""The same bank on filterpy: slow, independent, for checking the compiled one.

Shared with it are only the model's constants and the start of a grasp; the discretisation (scipy's matrix exponential
of the whole linearised system) and the filter equations (filterpy's) are others.
"""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import expm

from estimator.bank import (
    DISPLACEMENT_FLOOR_SD_M,
    FORCE_NOISE_SD_N,
    LOG_ALPHA,
    LOG_BETA,
    LOG_DAMPING,
    LOG_WALK_SD,
    NIS_SURPRISING,
    OFFSET,
    STATES,
    STRAIN,
    WIDENING_MOST,
    Bank,
    V,
    X,
)


class ReferenceFilter(ExtendedKalmanFilter):
    """One tissue's filter. `u` of `predict_to` is the measured force at both ends of the step."""

    def __init__(self, mean: np.ndarray, cov: np.ndarray, mass_kg: float, dt_s: float, strain_var: float) -> None:
        super().__init__(dim_x=STATES, dim_z=1)
        self.x, self.P = mean.reshape(-1, 1).copy(), cov.copy()
        self.R = np.array([[DISPLACEMENT_FLOOR_SD_M**2]])
        self._mass_kg, self._dt_s, self._strain_var = mass_kg, dt_s, strain_var
        self.log_likelihood_sum = 0.0

    def predict_to(self, middle_n: float, newton_per_volt: float) -> None:
        """Time update over one sample under the mean measured force of the step, N."""
        x, v, a, b, d = self.x[:5, 0]
        alpha, beta, damping = np.exp([a, b, d])
        bent = np.exp(beta * max(x, 0.0))
        elastic = alpha * (bent - 1.0) if x > 0 else alpha * beta * x
        stiffness = alpha * beta * bent
        noise_by_force = -0.5 * newton_per_volt  # the strain error at either end drives half of the step
        force = middle_n + noise_by_force * self.x[STRAIN, 0]

        # linearised [x, x', log alpha, log beta, log d, e_before, e_after, constant]: exponentiated whole
        rate = np.zeros((8, 8))
        rate[0, 1] = 1.0
        rate[1, :7] = (
            np.array([-stiffness, -damping, -elastic, -stiffness * x, -damping * v, noise_by_force, noise_by_force])
            / self._mass_kg
        )
        acceleration = (force - damping * v - elastic) / self._mass_kg
        rate[0, 7], rate[1, 7] = v, acceleration
        step = expm(rate * self._dt_s)
        # the constant column integrates the derivative at the present state; deviations start at zero there
        self.x[X, 0] += step[0, 7]
        self.x[V, 0] += step[1, 7]
        self.x[STRAIN, 0] = 0.0

        transition = np.eye(STATES)
        transition[: V + 1, : LOG_DAMPING + 1] = step[:2, :5]
        transition[: V + 1, STRAIN] = step[:2, 5]
        transition[STRAIN, STRAIN] = 0.0
        fresh = np.zeros(STATES)
        fresh[: V + 1], fresh[STRAIN] = step[:2, 6], 1.0
        by_force = step[:2, 6] / noise_by_force
        noise = np.outer(fresh, fresh) * self._strain_var
        noise[: V + 1, : V + 1] += np.outer(by_force, by_force) * FORCE_NOISE_SD_N**2
        noise[[LOG_ALPHA, LOG_BETA, LOG_DAMPING], [LOG_ALPHA, LOG_BETA, LOG_DAMPING]] += LOG_WALK_SD**2
        self.P = transition @ self.P @ transition.T + noise

    def take(self, displacement_m: float, metre_per_volt: float) -> None:
        """Measurement update, and its log-likelihood."""
        row = np.zeros((1, STATES))
        row[0, X], row[0, OFFSET], row[0, STRAIN] = 1.0, 1.0, metre_per_volt
        plain_variance = float((row @ self.P @ row.T + self.R)[0, 0])
        surprise = (displacement_m - float((row @ self.x)[0, 0])) ** 2 / plain_variance
        if surprise > NIS_SURPRISING:
            wider = np.sqrt(min(surprise / NIS_SURPRISING, WIDENING_MOST)) * np.ones(STATES)
            wider[STRAIN] = 1.0
            self.P = self.P * np.outer(wider, wider)
        self.update(np.array([[displacement_m]]), HJacobian=lambda _: row, Hx=lambda state: row @ state)
        innovation, variance = float(self.y[0, 0]), plain_variance
        self.log_likelihood_sum -= 0.5 * (innovation**2 / variance + np.log(2 * np.pi * variance))


class ReferenceBank:
    """The filters of a started `Bank`, on filterpy."""

    def __init__(self, started: Bank) -> None:
        state = started.state
        self._last_n = float(state.last_force[0])
        self.filters = [
            ReferenceFilter(mean, cov, started.priors.mass_kg, started.dt_s, started.strain_var)
            for mean, cov in zip(state.mean, state.cov, strict=True)
        ]

    def advance(
        self, force_n: np.ndarray, displacement_m: np.ndarray, newton_per_volt: np.ndarray, metre_per_volt: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `Bank.advance`: means and variances after each sample, (n, K, 7) each."""
        means, variances = [], []
        for force, y, by_force, by_displacement in zip(
            force_n, displacement_m, newton_per_volt, metre_per_volt, strict=True
        ):
            for one in self.filters:
                one.predict_to(0.5 * (self._last_n + force), by_force)
                one.take(y, by_displacement)
            self._last_n = force
            means.append([one.x[:, 0].copy() for one in self.filters])
            variances.append([np.diag(one.P).copy() for one in self.filters])
        return np.array(means), np.array(variances)
