import itertools

import numpy as np
import pytest
from grasps import conditioned, signals
from hypothesis import given, settings
from hypothesis import strategies as st

from config.load import load_library, load_protocol, load_tool
from estimator.bank import LOG_ALPHA, LOG_BETA, LOG_DAMPING, Bank, Contact
from estimator.reference import ReferenceBank

TISSUES = ("liver", "small_bowel", "bladder", "gallbladder")


@pytest.fixture(scope="module", params=TISSUES)
def grasp(request):
    from config.load import load_settings

    tool, library = load_tool("simulated"), load_library("porcine")
    samples, specimen = conditioned(
        tool, library, load_settings(), load_protocol("trapezoid_2hz"), request.param, seed=3
    )
    return request.param, tool, library, signals(samples), specimen


def started(tool, library, force_n, metre_per_volt, unfelt_n=0.0):
    bank = Bank(tool, library)
    bank.start(Contact(float(force_n[0]), float(metre_per_volt[0]), unfelt_force_n=unfelt_n))
    return bank


@pytest.mark.parametrize("unfelt_n", [0.0, 0.005], ids=["contact sensed", "contact found from the force"])
def test_agrees_with_the_independent_bank_on_filterpy(grasp, unfelt_n):
    _, tool, library, (force, x, by_force, by_x), _ = grasp
    first = slice(0, 250)
    ours = started(tool, library, force, by_x, unfelt_n)
    theirs = ReferenceBank(ours)
    mean, variance = ours.advance(force[first], x[first], by_force[first], by_x[first])
    with np.errstate(all="ignore"):  # a diverged filter of the reference is not stopped
        reference_mean, reference_variance = theirs.advance(force[first], x[first], by_force[first], by_x[first])
    fits = ours.state.nis_sum / ours.state.updates[0] < 5
    assert fits.any()
    for k, close in enumerate(np.where(fits, 1e-9, 1e-3)):
        # a filter that is driven far from its tissue swings through exp(beta x) of 1e4 and more: rounding grows there
        sound = np.isfinite(mean[:, k])
        difference = np.abs(mean - reference_mean)[:, k][sound] / np.sqrt(reference_variance[:, k][sound])
        assert difference.max(initial=0.0) < close
        assert np.allclose(variance[:, k][sound], reference_variance[:, k][sound], rtol=close)


def test_the_right_filter_finds_the_specimen(grasp):
    tissue, tool, library, (force, x, by_force, by_x), specimen = grasp
    bank = started(tool, library, force, by_x)
    bank.advance(force, x, by_force, by_x)
    k = TISSUES.index(tissue)
    truth = np.log([specimen.alpha_n, specimen.beta_per_m, specimen.damping_kg_per_s])
    error = bank.state.mean[k, LOG_ALPHA : LOG_DAMPING + 1] - truth
    sd = np.sqrt(np.diag(bank.state.cov[k])[LOG_ALPHA : LOG_DAMPING + 1])
    assert np.all(np.abs(error) < 5 * sd)
    stiffness_error = bank.state.mean[k, LOG_ALPHA] + bank.state.mean[k, LOG_BETA] - truth[:2].sum()
    assert abs(stiffness_error) < 0.25  # alpha·beta is what force and displacement fix best


def test_the_right_filters_innovations_are_white(grasp):
    """A right noise model: the mean normalised innovation squared is 1 (SD of its mean sqrt(2/n) = 0.06)."""
    tissue, tool, library, (force, x, by_force, by_x), _ = grasp
    bank = started(tool, library, force, by_x)
    bank.advance(force, x, by_force, by_x)
    nis = bank.state.nis_sum / bank.state.updates[0]
    assert 0.7 < nis[TISSUES.index(tissue)] < 1.3


@settings(max_examples=25, deadline=None)
@given(cuts=st.lists(st.integers(1, 299), max_size=6), seed=st.integers(0, 2**31))
def test_the_result_does_not_depend_on_how_samples_are_cut(cuts, seed):
    tool, library = load_tool("simulated"), load_library("porcine")
    rng = np.random.default_rng(seed)
    force, x = np.linspace(0, 1.5, 300) + rng.normal(0, 0.015, 300), np.linspace(0, 5e-4, 300)
    by_force, by_x = np.full(300, 7.0), np.full(300, -6e-3)
    whole, pieces = started(tool, library, force, by_x), started(tool, library, force, by_x)
    mean, _ = whole.advance(force, x, by_force, by_x)
    edges = [0, *sorted(set(cuts)), 300]
    parts = [pieces.advance(force[a:b], x[a:b], by_force[a:b], by_x[a:b])[0] for a, b in itertools.pairwise(edges)]
    assert np.array_equal(np.concatenate(parts), mean, equal_nan=True)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    peak=st.floats(0.05, 5.0),
    travel=st.floats(1e-6, 1e-2),
    noise=st.floats(0.0, 0.1),
)
def test_covariances_stay_symmetric_and_positive_whatever_comes(seed, peak, travel, noise):
    tool, library = load_tool("simulated"), load_library("porcine")
    rng = np.random.default_rng(seed)
    ramp = np.minimum(np.linspace(0, 3, 400), 1.0)
    force, x = peak * ramp + rng.normal(0, noise, 400), travel * ramp + rng.normal(0, noise * 1e-3, 400)
    bank = started(tool, library, force, np.full(400, -6e-3))
    mean, variance = bank.advance(force, x, np.full(400, 7.0), np.full(400, -6e-3))
    assert (variance[np.isfinite(variance)] > 0).all()
    assert np.array_equal(np.isfinite(mean), np.isfinite(variance))
    for k, sound in enumerate(bank.state.valid):
        if sound:
            cov = bank.state.cov[k]
            assert np.array_equal(cov, cov.T)
            scale = np.sqrt(np.diag(cov))
            assert np.linalg.eigvalsh(cov / np.outer(scale, scale)).min() > -1e-6


def test_a_filter_fed_with_nonsense_is_marked_invalid_not_shown(tool, library):
    n = 300
    rng = np.random.default_rng(0)
    force, x = rng.uniform(-50, 50, n), rng.uniform(-0.02, 0.02, n)
    bank = started(tool, library, force, np.full(n, -6e-3))
    mean, _ = bank.advance(force, x, np.full(n, 7.0), np.full(n, -6e-3))
    assert np.isnan(mean[-1]).all()


def test_a_nan_in_the_input_never_comes_out_as_an_estimate(tool, library):
    n = 50
    force, x = np.linspace(0, 1, n), np.linspace(0, 3e-4, n)
    x[20] = np.nan
    bank = started(tool, library, force, np.full(n, -6e-3))
    mean, _ = bank.advance(force, x, np.full(n, 7.0), np.full(n, -6e-3))
    assert np.isfinite(mean[19]).any()
    assert np.isnan(mean[20:]).all()
    assert not bank.state.valid.any()


def test_takes_a_library_of_any_size(tool, library):
    two = library.model_copy(update={"tissues": {k: library.tissues[k] for k in ("liver", "bladder")}})
    bank = started(tool, two, np.zeros(1), np.full(1, -6e-3))
    mean, _ = bank.advance(np.zeros(5), np.zeros(5), np.full(5, 7.0), np.full(5, -6e-3))
    assert mean.shape == (5, 2, 7)
