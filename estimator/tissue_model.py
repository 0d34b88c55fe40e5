"""Functions of the tissue model, Eqs. (7) to (11), and of its exact local discretization; most are compiled.

The printed explicit Euler step (19) is unstable for a 5 g mass at 1 ms. Here the local linearization is integrated
exactly over the step, Eq. (14). The 2x2 matrix exponential of displacement and velocity is in closed form, and the
force changes linearly from one sample to the next. The parameters' rows of the transition matrix are identity.
"""

import math

import numpy as np

from acquisition.compilation import compiled
from estimator.constants import EXPONENT_LIMIT


@compiled
def elastic_force(alpha_n: float, beta_per_m: float, x_m: float) -> float:
    """Return alpha (exp(beta x) - 1), N. For x < 0 it continues linearly, so that its slope never vanishes."""
    if x_m < 0.0:
        return alpha_n * beta_per_m * x_m
    return alpha_n * math.expm1(min(beta_per_m * x_m, EXPONENT_LIMIT))


@compiled
def tangent_stiffness(alpha_n: float, beta_per_m: float, x_m: float) -> float:
    """Return the slope of the elastic force, alpha beta exp(beta x), N/m."""
    return alpha_n * beta_per_m * math.exp(min(beta_per_m * max(x_m, 0.0), EXPONENT_LIMIT))


@compiled
def step_matrices(
    mass_kg: float, stiffness_n_per_m: float, damping_kg_per_s: float, dt_s: float, step: np.ndarray
) -> None:
    """Compute the exact step of m x'' + d x' + k x = u over dt, for u that changes linearly from u0 to u1.

    The result goes into `step`, shape (2, 4), with rows for displacement and velocity. Columns 0 and 1 hold the
    transition, column 2 the response to a constant u0, and column 3 the response to the rise u1 - u0.
    """
    k = stiffness_n_per_m / mass_kg
    c = damping_kg_per_s / mass_kg
    half = 0.5 * c
    discriminant = half * half - k
    if discriminant > 1e-6 * half * half:
        root = math.sqrt(discriminant)
        slow = math.exp((root - half) * dt_s)
        fast = math.exp((-root - half) * dt_s)
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / root
    elif discriminant < -1e-6 * half * half:
        root = math.sqrt(-discriminant)
        decay = math.exp(-half * dt_s)
        even, odd = decay * math.cos(root * dt_s), decay * math.sin(root * dt_s) / root
    else:
        decay = math.exp(-half * dt_s)
        even, odd = (
            decay * (1.0 + 0.5 * discriminant * dt_s * dt_s),
            decay * dt_s * (1.0 + discriminant * dt_s * dt_s / 6.0),
        )
    step[0, 0], step[0, 1] = even + half * odd, odd
    step[1, 0], step[1, 1] = -k * odd, even - half * odd
    step[0, 2] = (1.0 - step[0, 0]) / (k * mass_kg)
    step[1, 2] = odd / mass_kg
    held_x, held_v = step[0, 2] / dt_s, step[1, 2] / dt_s - 1.0 / mass_kg
    step[0, 3] = -(c * held_x + held_v) / k
    step[1, 3] = held_x


def elastic_force_array(alpha_n: np.ndarray | float, beta_per_m: np.ndarray | float, x_m: np.ndarray) -> np.ndarray:
    """Return alpha (exp(beta x) - 1), N, for an array of displacements, m, also where x is negative.

    `elastic_force` takes one number, and continues as a line for x < 0.
    """
    return alpha_n * np.expm1(np.minimum(beta_per_m * x_m, EXPONENT_LIMIT))
