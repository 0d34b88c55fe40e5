import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from config.load import load_library
from estimator.tissue_model import elastic_force, step_matrices, tangent_stiffness

MASS_KG, DT_S = 0.005, 1e-3
stiffness = st.floats(1e-2, 1e6)
damping = st.floats(1e-3, 1e2)


def step_of(k, d, mass_kg=MASS_KG):
    step = np.empty((2, 4))
    step_matrices(mass_kg, k, d, DT_S, step)
    return step


@given(stiffness, damping, st.floats(5e-4, 5e-2))
def test_step_is_the_exponential_of_the_linear_system_under_a_force_that_goes_straight(k, d, mass_kg):
    """The augmented system [x, v, force, its rise over the step] has all four columns in its exponential."""
    system = np.zeros((4, 4))
    system[0, 1], system[1, :3], system[2, 3] = 1.0, np.array([-k, -d, 1.0]) / mass_kg, 1.0 / DT_S
    exact, step = expm(system * DT_S)[:2], step_of(k, d, mass_kg)
    scale = np.abs(exact[:, :2]).max(axis=1, keepdims=True)
    assert np.allclose(step[:, :2] / scale, exact[:, :2] / scale, rtol=0, atol=1e-8)
    # Answers to the force, against the largest that this mass can give. They are differences of nearly equal numbers
    # divided by k, twice for the rise: rounding grows as 1/k², to 1e-6 at 1 N/m. Bladder has 4 N/m at contact.
    largest = np.array([[0.5 * DT_S**2 / mass_kg], [DT_S / mass_kg]])
    close = 2e-6 / min(k, 1.0) ** 2
    assert np.allclose(step[:, 2:] / largest, exact[:, 2:] / largest, rtol=0, atol=close)


@given(stiffness, damping)
def test_step_is_stable_where_explicit_euler_is_not(k, d):
    assert max(abs(np.linalg.eigvals(step_of(k, d)[:, :2]))) <= 1.0 + 1e-12


@given(st.floats(1e-3, 1e3), st.floats(1.0, 3e3), st.floats(-1e-3, 2e-3))
def test_tangent_stiffness_is_the_slope_of_the_force(alpha, beta, x):
    h = 1e-9
    if abs(x) < 2 * h:
        return  # the curve bends at contact
    slope = (elastic_force(alpha, beta, x + h) - elastic_force(alpha, beta, x - h)) / (2 * h)
    assert math.isclose(slope, tangent_stiffness(alpha, beta, x), rel_tol=1e-4, abs_tol=1e-4 * alpha * beta)


def test_explicit_euler_would_be_unstable_for_every_stiff_tissue_of_the_paper_and_ours_is_not():
    """PHYSICS: spectral radius 1.68, 1.26, 1.33 for liver, small bowel, gallbladder as printed at 1 ms."""
    printed = load_library("paper_table2")
    radius = {}
    for name in ("liver", "small_bowel", "gallbladder"):
        tissue = printed.tissues[name]
        k, d = tangent_stiffness(tissue.alpha_n, tissue.beta_per_m, 0.0), tissue.damping_kg_per_s
        euler = np.eye(2) + DT_S * np.array([[0.0, 1.0], [-k / printed.mass_kg, -d / printed.mass_kg]])
        radius[name] = max(abs(np.linalg.eigvals(euler)))
        assert max(abs(np.linalg.eigvals(step_of(k, d, printed.mass_kg)[:, :2]))) < 1.0
    assert radius == pytest.approx({"liver": 1.68, "small_bowel": 1.26, "gallbladder": 1.33}, abs=0.03)
