import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from config.load import load_library, load_settings, load_tool
from estimator.constants import FILLED_JAWS_MARGIN_M, FOLD_PROBABILITY
from estimator.evidence import BankEvidence, compute_marginal_log_likelihood, compute_parameter_likelihood
from estimator.filter_bank import ContactStart, FilterBank
from estimator.kalman_filter import PARAMETERS, STATE_COUNT
from estimator.studies.out_of_library import OUT_OF_LIBRARY

TOOL, LIBRARY, SETTINGS = load_tool("simulated"), load_library("porcine"), load_settings().identification
OPENING_M = TOOL.geometry.opening_m


def library_of(names):
    tissues = {**LIBRARY.tissues, **OUT_OF_LIBRARY.tissues}
    return LIBRARY.model_copy(update={"tissues": {name: tissues[name] for name in names}})


def after_ramp(library, peak_n, travel_m, seed=0, n=200):
    rng = np.random.default_rng(seed)
    strain = rng.normal(0, 0.002, n)
    force, x = np.linspace(0, peak_n, n) + 7 * strain, np.linspace(0, travel_m, n) - 6e-3 * strain
    samples = np.column_stack([force, x, np.full(n, 7.0), np.full(n, -6e-3), np.full(n, 1e-3)])
    bank = FilterBank.from_tool(TOOL, library)
    bank.start(ContactStart(samples[0]))
    bank.advance(samples[1:])
    return bank


def evidence_of(bank, library=LIBRARY):
    return BankEvidence(bank, library, SETTINGS)


@settings(max_examples=60)
@given(
    peak=st.floats(0.01, 6),
    travel=st.floats(-1e-3, 1e-2),
    seed=st.integers(0, 2**31),
    closed_m=st.floats(-1e-3, 0.03),
    names=st.lists(st.sampled_from([*LIBRARY.tissues, *OUT_OF_LIBRARY.tissues]), min_size=1, max_size=7, unique=True),
)
def test_probabilities_are_probabilities(peak, travel, seed, closed_m, names):
    library = library_of(names)
    evidence = evidence_of(after_ramp(library, peak, travel, seed), library)
    for other in (0.0, evidence.compute_thickness_log_likelihood(closed_m, OPENING_M)):
        p = evidence.probabilities(other)
        assert p.shape == (len(names) + 1,)
        assert np.isfinite(p).all()
        assert (p >= 0).all()
        assert abs(p.sum() - 1) < 1e-9


@pytest.mark.parametrize("names", [["liver"], list(LIBRARY.tissues)], ids=len)
def test_before_any_data_the_prior_holds(names):
    library = library_of(names)
    bank = FilterBank.from_tool(TOOL, library)
    evidence = evidence_of(bank, library)
    assert np.isclose(evidence.prior[-1], SETTINGS.prior_unknown)
    assert np.allclose(evidence.prior[:-1], (1 - SETTINGS.prior_unknown) / len(names))
    assert np.allclose(evidence.probabilities(), evidence.prior)


@settings(max_examples=15)
@given(order=st.permutations(list(LIBRARY.tissues)), peak=st.floats(0.3, 3), closed_m=st.floats(0.0, 0.012))
def test_the_order_of_the_library_does_not_matter(order, peak, closed_m):
    named = []
    for library in (LIBRARY, library_of(order)):
        evidence = evidence_of(after_ramp(library, peak, 5e-4), library)
        p = evidence.probabilities(evidence.compute_thickness_log_likelihood(closed_m, OPENING_M))
        named.append(dict(zip((*library.tissues, "unknown"), p, strict=True)))
    assert named[0] == pytest.approx(named[1], abs=1e-9)


def test_a_thing_far_outside_the_library_is_unknown():
    """A spring a hundred times stiffer than liver, and one a hundred times softer than gallbladder."""
    for peak_n, travel_m in ((1.5, 6e-6), (0.02, 6e-3)):
        assert evidence_of(after_ramp(LIBRARY, peak_n, travel_m)).probabilities()[-1] > 0.9


def test_moving_a_likelihood_equals_integrating_it():
    """Against Gaussian algebra done another way: the integral of N(y; theta, C) N(theta; mu, S) is N(y; mu, C + S)."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    seen, cov = rng.normal(size=3), root @ root.T + 0.1 * np.eye(3)
    information = np.linalg.inv(cov)
    means, variances = rng.normal(size=(5, 3)), rng.uniform(0.01, 2, (5, 3))
    ours = [
        compute_marginal_log_likelihood(information, information @ seen, m, v)
        for m, v in zip(means, variances, strict=True)
    ]
    exact = [multivariate_normal(m, cov + np.diag(v)).logpdf(seen) for m, v in zip(means, variances, strict=True)]
    assert np.allclose(np.array(ours) - ours[0], np.array(exact) - exact[0], atol=1e-9)


def state_of(parameters, inner):
    mean, cov = np.zeros(STATE_COUNT), np.eye(STATE_COUNT)
    mean[PARAMETERS], cov[PARAMETERS, PARAMETERS] = parameters, inner
    return mean, cov


positive = st.floats(0.05, 2.0)


@given(seed=st.integers(0, 2**31), sd=st.tuples(positive, positive, positive))
def test_the_parameters_likelihood_is_the_posterior_divided_by_the_prior(seed, sd):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3))
    seen, information = rng.normal(size=3), root @ root.T + 0.1 * np.eye(3)
    guess, guess_var = rng.normal(size=3), np.array(sd) ** 2
    cov = np.linalg.inv(information + np.diag(1 / guess_var))
    mean = cov @ (information @ seen + guess / guess_var)
    found, vector = compute_parameter_likelihood(*state_of(mean, cov), guess, guess_var)
    assert np.allclose(found, information, rtol=1e-6, atol=1e-6)
    assert np.allclose(vector, information @ seen, rtol=1e-6, atol=1e-6)


@given(seed=st.integers(0, 2**31), sd=st.tuples(positive, positive, positive), wider=st.floats(1.0, 64.0))
def test_the_parameters_likelihood_is_positive_semi_definite_even_after_widening(seed, sd, wider):
    """A filter that was widened knows less than its prior along some direction: nothing is to be held against it."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3)) * rng.uniform(0.1, 10)
    guess, guess_var = rng.normal(size=3), np.array(sd) ** 2
    cov = wider * np.linalg.inv(root @ root.T + np.diag(1 / guess_var))
    mean = guess + rng.normal(size=3)
    information, vector = compute_parameter_likelihood(*state_of(mean, cov), guess, guess_var)
    assert np.isfinite(vector).all()
    unit = np.sqrt(guess_var)
    size = np.linalg.eigvalsh(information * np.outer(unit, unit))
    assert size[0] >= -1e-9 * max(size[-1], 1.0)
    if wider > 1.0 and np.linalg.eigvalsh(root @ root.T * np.outer(unit, unit))[0] < wider - 1.0:
        posterior = np.linalg.inv(cov) * np.outer(unit, unit) - np.eye(3)
        assert np.allclose(size, np.maximum(np.linalg.eigvalsh(posterior), 0.0), atol=1e-6 * max(size[-1], 1.0))


@given(closed_m=st.floats(-1e-3, 0.05), opening_m=st.floats(1e-4, 0.05))
def test_thickness_alone_rules_no_tissue_out(closed_m, opening_m):
    """An edge or a fold may have been taken: against `unknown` no tissue loses more than the folded share."""
    found = evidence_of(FilterBank.from_tool(TOOL, LIBRARY)).compute_thickness_log_likelihood(closed_m, opening_m)
    assert np.isfinite(found).all()
    assert (found - found[-1] >= math.log(FOLD_PROBABILITY) - 1e-12).all()


def test_tissue_that_fills_the_jaws_is_at_least_as_thick():
    """Bladder, 26 mm, is met at once between jaws that open 10 mm: as likely as can be, however much thicker it is."""
    evidence = evidence_of(FilterBank.from_tool(TOOL, LIBRARY))
    filled = np.exp(evidence.compute_thickness_log_likelihood(0.0, OPENING_M))
    bladder, bowel = (list(LIBRARY.tissues).index(name) for name in ("bladder", "small_bowel"))
    assert filled[bladder] == pytest.approx(1 - FOLD_PROBABILITY + FOLD_PROBABILITY * filled[-1], abs=1e-4)
    assert filled[bowel] < 0.05  # 5.5 mm cannot fill 10 mm, except as a fold
    assert np.argmax(evidence.probabilities(evidence.compute_thickness_log_likelihood(0.0, OPENING_M))) != bowel
    wider = evidence.compute_thickness_log_likelihood(FILLED_JAWS_MARGIN_M / 2, OPENING_M)
    assert np.array_equal(
        wider, evidence.compute_thickness_log_likelihood(0.0, OPENING_M)
    )  # within the margin it is all the same


def test_a_measured_thickness_speaks_for_the_tissue_that_has_it():
    evidence = evidence_of(FilterBank.from_tool(TOOL, LIBRARY))
    for index, (name, profile) in enumerate(LIBRARY.tissues.items()):
        if profile.thickness_m < OPENING_M - FILLED_JAWS_MARGIN_M:
            found = evidence.compute_thickness_log_likelihood(OPENING_M - profile.thickness_m, OPENING_M)
            assert np.argmax(found) == index, name


def test_all_filters_diverged_means_unknown():
    bank = after_ramp(LIBRARY, 1.0, 5e-4)
    bank.state.valid[:] = False
    assert bank.find_likeliest_filter() == -1
    assert evidence_of(bank).probabilities()[-1] == 1.0
