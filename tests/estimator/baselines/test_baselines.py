"""The rivals are themselves right: else they would make ours look good."""

import numpy as np
import pytest

from config.load import load_library, load_settings
from estimator.baselines.filterpy_reference import build_filterpy_identifier
from estimator.baselines.identifier import BankIdentifier
from estimator.baselines.paper_filter import PaperIdentifier
from estimator.baselines.particle_filter import ParticleIdentifier
from estimator.baselines.unscented_filter import build_unscented_identifier
from estimator.filter_bank import TissuePriors, build_contact_start
from estimator.studies.answer_course import StudyConditions, load_study_setup
from estimator.studies.paper_simulation import compute_log_parameters, run_paper_filters, simulate_sine
from estimator.studies.simulated_grasps import GraspCase, extract_contact_samples, simulate_grasp

LAB = load_study_setup(StudyConditions())
SETTINGS = LAB.settings.identification


def grasp(tissue, seed=5):
    simulated = simulate_grasp(LAB.tool, LAB.library, LAB.settings.conditioning, LAB.protocol, GraspCase(tissue, seed))
    return extract_contact_samples(simulated), simulated.specimen.log_parameters


def follow(identifier, samples, until=300):
    identifier.start(samples[0], build_contact_start(samples[0], 0.0, contact_sensed=True))
    identifier.advance(samples[1:until])
    return identifier


@pytest.mark.parametrize("tissue", ["liver", "gallbladder"])
def test_unscented_and_extended_filters_say_the_same_where_the_curve_is_mild(tissue):
    samples, _ = grasp(tissue)
    ours = follow(BankIdentifier.from_tool(LAB.tool, LAB.library, SETTINGS), samples)
    theirs = follow(build_unscented_identifier(LAB.tool, LAB.library, SETTINGS), samples)
    k = TissuePriors.from_library(LAB.library).names.index(tissue)
    sd = np.sqrt(np.diag(ours.bank.state.cov[k])[2:5])
    assert (np.abs(ours.bank.state.mean[k, 2:5] - theirs.bank.state.mean[k, 2:5]) < sd).all()
    assert np.allclose(ours.probabilities(), theirs.probabilities(), atol=0.15)


def test_the_bank_on_filterpy_gives_the_same_probabilities():
    """To rounding: it is the same mathematics, written again on another library."""
    samples, _ = grasp("gallbladder")
    ours = follow(BankIdentifier.from_tool(LAB.tool, LAB.library, SETTINGS), samples, until=120)
    theirs = follow(build_filterpy_identifier(LAB.tool, LAB.library, SETTINGS), samples, until=120)
    assert np.allclose(ours.probabilities(), theirs.probabilities(), rtol=0, atol=1e-6)
    assert np.allclose(ours.log_parameters(), theirs.log_parameters(), rtol=0, atol=1e-6)


@pytest.mark.parametrize("maker", [build_unscented_identifier, ParticleIdentifier])
def test_unscented_and_particle_filters_find_the_specimen(maker):
    samples, truth = grasp("gallbladder")
    found = follow(maker(LAB.tool, LAB.library, SETTINGS), samples)
    assert int(np.argmax(found.probabilities())) == 3
    assert (np.abs(found.log_parameters() - truth) < [0.2, 0.1, 0.3]).all()


def test_the_papers_filter_converges_from_a_close_guess_on_the_papers_data():
    library = load_library("paper_table2")
    for name, profile in library.tissues.items():
        run = simulate_sine(profile, library.mass_kg, 1)
        guess = 1.05 * np.exp(compute_log_parameters(profile))
        means, elastic_n, force_n = run_paper_filters(run, guess[None], library.mass_kg, load_settings().conditioning)
        alpha, beta = means[-1, 0, 2:4]
        assert alpha * beta == pytest.approx(profile.alpha_n * profile.beta_per_m, rel=0.15), name
        if name != "bladder":  # damping takes most of its force
            assert np.abs(elastic_n[300:, 0] - force_n[300:]).max() < run.convergence_bound_n


def test_the_papers_filter_that_diverges_says_so():
    samples, _ = grasp("bladder")
    found = follow(PaperIdentifier(LAB.tool, LAB.library, SETTINGS), samples)
    probabilities = found.probabilities()
    assert np.isfinite(probabilities).all()
    assert probabilities.sum() == pytest.approx(1.0)
    assert 0 <= found.choose_by_criteria() < 4
