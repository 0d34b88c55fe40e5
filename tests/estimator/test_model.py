import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from estimator.model import elastic_force, step_matrices, tangent_stiffness

stiffness = st.floats(1e-2, 1e6)
damping = st.floats(1e-3, 1e2)


@given(stiffness, damping)
def test_step_is_the_exponential_of_the_linear_system(k, d):
    mass, dt = 0.005, 1e-3
    step = np.empty((2, 4))
    step_matrices(mass, k, d, dt, step)
    system = np.zeros((4, 4))
    system[0, 1], system[1, 0], system[1, 1] = 1.0, -k / mass, -d / mass
    system[0, 2] = system[1, 3] = 1.0
    exact = expm(system * dt)[:2]
    scale = np.abs(exact).max(axis=1, keepdims=True)
    assert np.allclose(step / scale, exact / scale, atol=1e-8)


@given(stiffness, damping)
def test_step_is_stable_where_explicit_euler_is_not(k, d):
    step = np.empty((2, 4))
    step_matrices(0.005, k, d, 1e-3, step)
    assert max(abs(np.linalg.eigvals(step[:, :2]))) <= 1.0 + 1e-12


@given(st.floats(1e-3, 1e3), st.floats(1.0, 3e3), st.floats(-1e-3, 2e-3))
def test_tangent_stiffness_is_the_slope_of_the_force(alpha, beta, x):
    h = 1e-9
    if abs(x) < 2 * h:
        return  # the curve bends at contact
    slope = (elastic_force(alpha, beta, x + h) - elastic_force(alpha, beta, x - h)) / (2 * h)
    assert math.isclose(slope, tangent_stiffness(alpha, beta, x), rel_tol=1e-4, abs_tol=1e-4 * alpha * beta)


def test_explicit_euler_would_be_unstable_for_every_stiff_tissue(library):
    """PHYSICS: spectral radius 1.68, 1.26, 1.33 for liver, small bowel, gallbladder as printed at 1 ms."""
    radius = {}
    for name, (alpha, beta, d) in {
        "liver": (849.2, 14.32, 3.1), "small_bowel": (518.9, 11.87, 3.3), "gallbladder": (379.3, 11.26, 0.5)
    }.items():  # fmt: skip
        euler = np.eye(2) + 1e-3 * np.array([[0.0, 1.0], [-alpha * beta / 0.005, -d / 0.005]])
        radius[name] = max(abs(np.linalg.eigvals(euler)))
    assert radius == pytest.approx({"liver": 1.68, "small_bowel": 1.26, "gallbladder": 1.33}, abs=0.03)
