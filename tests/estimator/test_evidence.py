import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from config.load import load_library, load_settings, load_tool
from estimator.bank import LOG_ALPHA, Bank, Contact
from estimator.evidence import Evidence, moved_evidence

TOOL, LIBRARY, SETTINGS = load_tool("simulated"), load_library("porcine"), load_settings().identification


def after_ramp(library, peak_n, travel_m, seed=0, n=200):
    bank = Bank(TOOL, library)
    rng = np.random.default_rng(seed)
    strain = rng.normal(0, 0.002, n)
    force, x = np.linspace(0, peak_n, n) + 7 * strain, np.linspace(0, travel_m, n) - 6e-3 * strain
    bank.start(Contact(float(force[0]), -6e-3))
    bank.advance(force, x, np.full(n, 7.0), np.full(n, -6e-3))
    return bank


@settings(max_examples=30, deadline=None)
@given(peak=st.floats(0.01, 6), travel=st.floats(-1e-3, 1e-2), seed=st.integers(0, 2**31))
def test_probabilities_are_probabilities(peak, travel, seed):
    p, _ = Evidence(after_ramp(LIBRARY, peak, travel, seed), SETTINGS).probabilities()
    assert np.isfinite(p).all()
    assert (p >= 0).all()
    assert abs(p.sum() - 1) < 1e-9


def test_before_any_data_the_prior_holds():
    bank = Bank(TOOL, LIBRARY)
    evidence = Evidence(bank, SETTINGS)
    assert np.isclose(evidence.prior[-1], SETTINGS.prior_unknown)
    assert np.allclose(evidence.prior[:-1], (1 - SETTINGS.prior_unknown) / 4)


@settings(max_examples=10, deadline=None)
@given(order=st.permutations(list(LIBRARY.tissues)))
def test_the_order_of_the_library_does_not_matter(order):
    shuffled = LIBRARY.model_copy(update={"tissues": {name: LIBRARY.tissues[name] for name in order}})
    p, _ = Evidence(after_ramp(LIBRARY, 1.2, 5e-4), SETTINGS).probabilities()
    q, _ = Evidence(after_ramp(shuffled, 1.2, 5e-4), SETTINGS).probabilities()
    named, shuffled_named = dict(zip(LIBRARY.tissues, p, strict=False)), dict(zip(order, q, strict=False))
    assert all(abs(named[name] - shuffled_named[name]) < 1e-6 for name in named)


def test_a_thing_far_outside_the_library_is_unknown():
    """A spring a hundred times stiffer than liver, and one a hundred times softer than gallbladder."""
    for peak_n, travel_m in ((1.5, 6e-6), (0.02, 6e-3)):
        p, _ = Evidence(after_ramp(LIBRARY, peak_n, travel_m), SETTINGS).probabilities()
        assert p[-1] > 0.9


def test_moving_a_likelihood_equals_integrating_it():
    """Against Gaussian algebra done another way: the integral of N(y; theta, C) N(theta; mu, S) is N(y; mu, C + S)."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    seen, cov = rng.normal(size=3), root @ root.T + 0.1 * np.eye(3)
    information = np.linalg.inv(cov)
    means, variances = rng.normal(size=(5, 3)), rng.uniform(0.01, 2, (5, 3))
    ours = [moved_evidence(information, information @ seen, m, v) for m, v in zip(means, variances, strict=True)]
    exact = [multivariate_normal(m, cov + np.diag(v)).logpdf(seen) for m, v in zip(means, variances, strict=True)]
    assert np.allclose(np.array(ours) - ours[0], np.array(exact) - exact[0], atol=1e-9)


def test_all_filters_diverged_means_unknown():
    bank = after_ramp(LIBRARY, 1.0, 5e-4)
    bank.state.valid[:] = False
    p, best = Evidence(bank, SETTINGS).probabilities()
    assert best == -1
    assert p[-1] == 1.0
    assert bank.state.mean[:, LOG_ALPHA].shape == (4,)
