"""The tissue model, Eqs. (7) to (11), and its exact local discretisation, compiled.

The printed explicit Euler step (19) is unstable for a 5 g mass at 1 ms. Here the local linearisation is integrated
exactly over the step, Eq. (14), with the 2x2 matrix exponential of displacement and velocity in closed form; the rows
of the parameters are identity.
"""

import math

import numpy as np
from numba import njit

EXPONENT_LIMIT = 50.0  # beta x beyond which a filter has diverged; exp(50) is beyond any tissue


@njit(cache=True)
def elastic_force(alpha_n: float, beta_per_m: float, x_m: float) -> float:
    """alpha (exp(beta x) - 1), N. Below contact it goes on straight, so that its slope never vanishes."""
    if x_m < 0.0:
        return alpha_n * beta_per_m * x_m
    return alpha_n * math.expm1(min(beta_per_m * x_m, EXPONENT_LIMIT))


@njit(cache=True)
def tangent_stiffness(alpha_n: float, beta_per_m: float, x_m: float) -> float:
    """Slope of the elastic force, alpha beta exp(beta x), N/m."""
    return alpha_n * beta_per_m * math.exp(min(beta_per_m * max(x_m, 0.0), EXPONENT_LIMIT))


@njit(cache=True)
def acceleration(mass_kg, x_m, v_m_per_s, alpha_n, beta_per_m, damping_kg_per_s, force_n):
    """Eq. (8): (u - d x' - alpha (exp(beta x) - 1)) / m."""
    return (force_n - damping_kg_per_s * v_m_per_s - elastic_force(alpha_n, beta_per_m, x_m)) / mass_kg


@njit(cache=True)
def step_matrices(mass_kg, stiffness_n_per_m, damping_kg_per_s, dt_s, step):
    """The exact step of z' = A z + f over dt for A = [[0, 1], [-k/m, -d/m]].

    Writes into `step`, shape (2, 4): the transition exp(A dt) in columns 0 and 1, its integral over dt in 2 and 3.
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
        even, odd = decay, decay * dt_s
    step[0, 0], step[0, 1] = even + half * odd, odd
    step[1, 0], step[1, 1] = -k * odd, even - half * odd
    step[0, 2] = -(c * (step[0, 0] - 1.0) + step[1, 0]) / k
    step[0, 3] = -(c * odd + step[1, 1] - 1.0) / k
    step[1, 2] = step[0, 0] - 1.0
    step[1, 3] = odd


def force_curve(alpha_n: float, beta_per_m: float, x_m: np.ndarray) -> np.ndarray:
    """alpha (exp(beta x) - 1) for an array of displacements, N."""
    return alpha_n * np.expm1(np.minimum(beta_per_m * x_m, EXPONENT_LIMIT))
