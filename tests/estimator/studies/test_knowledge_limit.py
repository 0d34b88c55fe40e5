"""The limit of what a grasp's samples tell, against computations done by hand or another way."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from acquisition.simulation.tissue import NO_DEVIATION, Specimen
from config.load import load_library
from estimator.studies.answer_course import StudyConditions, load_study_setup
from estimator.studies.knowledge_limit import compute_case_limit, compute_information, compute_log_densities, mean_limit
from estimator.studies.simulated_grasps import GraspCase, extract_contact_samples, simulate_grasp

LIBRARY = load_library("porcine")
EXACT = np.zeros((3, 3))


def test_densities_are_those_of_the_librarys_spreads():
    seen, thickness_m = np.log([0.04, 2000.0, 3.0]), 0.0065
    found = compute_log_densities(LIBRARY, seen[None], EXACT, thickness_m)[0]
    for value, (name, profile) in zip(found, LIBRARY.tissues.items(), strict=True):
        alpha = LIBRARY.compute_apparent_alpha(name)
        by_hand = sum(
            norm.logpdf(x, math.log(centre), sd)
            for x, centre, sd in zip(
                [*seen, math.log(thickness_m)],
                [alpha.median_n, profile.beta_per_m, profile.damping_kg_per_s, profile.thickness_m],
                (alpha.log_sd, 0.10, 0.30, 0.20),
                strict=True,
            )
        )
        assert value == pytest.approx(by_hand + 4 * 0.5 * math.log(2 * math.pi))  # without the common constant


@pytest.mark.parametrize("tissue", ["bladder", "gallbladder"])
def test_a_folds_alpha_is_that_of_the_simulated_folds(tissue: str):
    draws = np.random.default_rng(1).standard_normal((20_000, 5)).tolist()
    alpha = np.log([Specimen.draw(LIBRARY, tissue, draw, NO_DEVIATION).material.alpha_n for draw in draws])
    held = LIBRARY.compute_apparent_alpha(tissue)
    error = held.log_sd / math.sqrt(len(alpha))
    assert alpha.mean() == pytest.approx(math.log(held.median_n), abs=4 * error)
    assert alpha.std() == pytest.approx(held.log_sd, abs=4 * error)
    low_n, high_n = LIBRARY.tissues[tissue].preload_n
    assert np.exp(alpha.min()) > low_n
    assert np.exp(alpha.max()) < high_n + 4 * LIBRARY.tissues[tissue].alpha_n


@pytest.mark.parametrize(("known", "apart"), [("beta and d", 1.25), ("alpha, beta, d", 2.33), ("and thickness", 2.80)])
def test_liver_and_small_bowel_are_as_far_apart_as_their_profiles(known: str, apart: float):
    """Two Gaussians `apart` standard deviations from each other are told apart in a share of Phi(apart / 2)."""
    draws = np.random.default_rng(2).standard_normal((4000, 5)).tolist()
    bound = np.diag([1e6 if known == "beta and d" else 0.0, 0.0, 0.0])
    right = []
    for own, other in ((0, 1), (1, 0)):
        held = [Specimen.draw(LIBRARY, [*LIBRARY.tissues][own], draw, NO_DEVIATION) for draw in draws]
        seen = np.log([each.material[:3] for each in held])
        thickness_m = np.array([each.thickness_m for each in held]) if known == "and thickness" else None
        density = compute_log_densities(LIBRARY, seen, bound, thickness_m)
        right.append((density[:, own] > density[:, other]).mean())
    assert np.mean(right) == pytest.approx(norm.cdf(apart / 2), abs=4 * math.sqrt(0.2 / 8000))


def test_samples_tell_more_the_more_there_are_and_the_less_noise_they_have():
    bounds = {}
    for mv in (2.0, 4.0):
        lab = load_study_setup(StudyConditions(noise_mv=mv))
        grasp = simulate_grasp(lab.tool, lab.library, lab.settings.conditioning, lab.protocol, GraspCase("liver", 3))
        truth = np.log(grasp.specimen.material[:3])
        information = compute_information(lab.tool, lab.library, extract_contact_samples(grasp), 15e-6, truth)
        assert (np.diff(np.linalg.eigvalsh(information[[50, 100, 200]]), axis=0) > 0).all()
        bounds[mv] = np.sqrt(np.diag(np.linalg.inv(information[200])))
        sensed = np.sqrt(np.diag(np.linalg.inv(information[200, :3, :3])))
        assert (sensed < bounds[mv][:3]).all(), "an unknown zero makes every parameter less certain"
    assert bounds[4.0] == pytest.approx(2 * bounds[2.0], rel=0.15)  # with the encoder's rounding beside it
    assert bounds[2.0][0] > 0.1, "without sensed contact, alpha is known to a tenth at best"


def test_the_limit_without_sensed_contact_is_lower_and_a_bladder_has_none():
    bench, times_s = StudyConditions(), (0.15, 1.0)
    limits = [
        compute_case_limit(bench, GraspCase(name, seed), times_s)
        for name in ("liver", "small_bowel")
        for seed in range(12)
    ]
    sensed, unsensed = (mean_limit(limits, sensed=each) for each in (True, False))
    assert (unsensed < sensed).all()
    assert (sensed < 1.0).all()
    bladder = compute_case_limit(bench, GraspCase("bladder", 1), times_s)
    assert min(bladder.exact, *bladder.sensed, *bladder.unsensed) > 0.999
