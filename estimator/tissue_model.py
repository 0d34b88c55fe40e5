"""The tissue model, Eqs. (7) to (11), and its exact local discretisation, compiled.

The printed explicit Euler step (19) is unstable for a 5 g mass at 1 ms. Here the local linearisation is integrated
exactly over the step, Eq. (14), with the 2x2 matrix exponential of displacement and velocity in closed form, under a
force that goes straight from one sample to the next; the rows of the parameters are identity.
"""

import math

import numpy as np

from estimator.compilation import compiled
from estimator.constants import EXPONENT_LIMIT


@compiled
def elastic_force(alpha_n: float, beta_per_m: float, x_m: float) -> float:
    """alpha (exp(beta x) - 1), N. Below contact it goes on straight, so that its slope never vanishes."""
    if x_m < 0.0:
        return alpha_n * beta_per_m * x_m
    return alpha_n * math.expm1(min(beta_per_m * x_m, EXPONENT_LIMIT))


@compiled
def tangent_stiffness(alpha_n: float, beta_per_m: float, x_m: float) -> float:
    """Slope of the elastic force, alpha beta exp(beta x), N/m."""
    return alpha_n * beta_per_m * math.exp(min(beta_per_m * max(x_m, 0.0), EXPONENT_LIMIT))


@compiled
def step_matrices(mass_kg, stiffness_n_per_m, damping_kg_per_s, dt_s, step):
    """The exact step of m x'' + d x' + k x = u over dt, for u that goes straight from u0 to u1.

    Writes into `step`, shape (2, 4), rows for displacement and velocity: the transition in columns 0 and 1, the answer
    to u0 held over the step in 2, and the answer to the rise by u1 - u0 in 3.
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


def force_curve(alpha_n: float, beta_per_m: float, x_m: np.ndarray) -> np.ndarray:
    """alpha (exp(beta x) - 1) for an array of displacements, N."""
    return alpha_n * np.expm1(np.minimum(beta_per_m * x_m, EXPONENT_LIMIT))
