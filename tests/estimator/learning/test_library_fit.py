"""Learning and naming, on grasps made by hand."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from learned import learner, pressed

from config.load import load_library, load_settings, load_tool
from config.schema import SourceConditions
from estimator.learning.cross_validation import cross_validate, folds
from estimator.learning.library_fit import find_base_tissue
from estimator.learning.recorded_grasps import LabeledRecording, RecordedGrasp, extract_loading_curves
from estimator.loading.learned_evidence import LearnedEvidence

TOOL, BASE, SETTINGS = load_tool("smart_tool_2013"), load_library("porcine"), load_settings()
LEARN = learner(TOOL, BASE)
SAME_DAY = SourceConditions(datetime(2026, 1, 1, tzinfo=UTC))
PARAMETERS = np.log([0.1, 500.0, 5.0])
STIFFNESS = {"bladder": 0.08, "liver": 0.6}


def recording(label, stiffness, seed=0, grasps=9, gap_deg=120.0):
    rng = np.random.default_rng(seed)
    made = tuple(
        RecordedGrasp(
            i + 1,
            pressed(stiffness * np.exp(rng.normal(0, 0.1)), gap_deg=gap_deg + rng.normal(0, 4), seed=100 * seed + i),
            PARAMETERS + rng.normal(0, 0.2, 3),
            None,
        )
        for i in range(grasps)
    )
    return LabeledRecording(label, f"{label}{seed}.lvm", f"{seed:02x}" * 32, made, SAME_DAY)


RECORDINGS = [recording(label, stiffness, seed) for seed, (label, stiffness) in enumerate(STIFFNESS.items(), 1)]


def answers(library, of, first=False):
    evidence = LearnedEvidence(library, TOOL, SETTINGS.identification, SAME_DAY)
    return np.array([evidence.start_grasp(None, first=first).process(grasp.samples) for grasp in of.grasps[1:]])


def test_grasps_of_another_recording_are_named():
    library = LEARN(RECORDINGS)
    for k, (label, stiffness) in enumerate(STIFFNESS.items()):
        assert list(library.tissues)[k] == label
        assert (answers(library, recording(label, stiffness, seed=7 + k))[:, k] > 0.95).all()


def test_what_fits_no_tissue_makes_unknown_likelier_and_is_never_named():
    found = answers(LEARN(RECORDINGS), recording("stone", 2.4, seed=9, gap_deg=20.0))
    assert found[:, -1].mean() > 5 * SETTINGS.identification.prior_unknown
    assert (found[:, :-1] < SETTINGS.identification.decide_at).all()


def test_probabilities_sum_to_one_and_begin_at_the_prior():
    library = LEARN(RECORDINGS)
    assert answers(library, RECORDINGS[0]).sum(axis=1) == pytest.approx(1.0)
    evidence = LearnedEvidence(library, TOOL, SETTINGS.identification, SAME_DAY)
    start = evidence.start_grasp(None, first=False).process(RECORDINGS[0].grasps[1].samples[:3])
    assert start == pytest.approx(evidence.prior)
    assert start[-1] == pytest.approx(library.learned.prior_unknown)


def test_the_order_of_recordings_does_not_matter():
    assert LEARN(RECORDINGS) == LEARN(RECORDINGS[::-1])


def test_an_outlying_grasp_hardly_changes_what_is_learned():
    spoilt = replace(RECORDINGS[0], grasps=(*RECORDINGS[0].grasps[:-1], recording("bladder", 3.0, 5).grasps[1]))
    sound, moved = (LEARN([first, RECORDINGS[1]]).tissues["bladder"].learned for first in (RECORDINGS[0], spoilt))
    deviation = np.sqrt(np.diag(sound.loading_covariance))
    off = (np.array(moved.recordings[0].centre) - sound.recordings[0].centre) / deviation
    assert np.abs(off).max() < 1.0


def test_a_first_grasp_is_left_out_and_said_to_be():
    learned = LEARN(RECORDINGS).tissues["bladder"].learned
    assert learned.grasps == 8
    assert "not preconditioned" in learned.recordings[0].left_out[0]


def test_a_first_grasp_is_believed_less():
    library = LEARN(RECORDINGS)
    usual, first = (answers(library, RECORDINGS[0], first=first).max(axis=1).mean() for first in (False, True))
    assert first < usual


def test_covariances_of_a_library_are_positive_definite_and_its_spread_is_their_diagonal():
    for profile in LEARN(RECORDINGS).tissues.values():
        np.linalg.cholesky(np.array(profile.learned.loading_covariance))
        cov = np.array(profile.learned.log_covariance)
        np.linalg.cholesky(cov)
        spread = profile.spread
        assert np.sqrt(np.diag(cov)) == pytest.approx(
            [spread.log_alpha, spread.log_beta, spread.log_damping, spread.log_thickness], rel=1e-3
        )


@pytest.mark.parametrize(
    ("label", "name"), [("smallbowel", "small_bowel"), ("Small_Bowel", "small_bowel"), ("ureter", None)]
)
def test_injury_thresholds_come_from_the_tissue_of_that_name(label, name):
    assert find_base_tissue(label, BASE) == name


def test_a_tissue_that_the_base_does_not_know_gets_its_lowest_threshold_and_that_is_said():
    library = LEARN([*RECORDINGS, recording("spleen", 0.3, 3)])
    assert library.tissues["spleen"].threshold_pa == min(each.threshold_pa for each in BASE.tissues.values())
    assert "spleen" in library.source
    assert library.tissues["liver"].threshold_pa == BASE.tissues["liver"].threshold_pa


def test_validation_asks_every_grasp_of_a_left_out_recording_that_its_tissue_has_another_of():
    four = [
        *RECORDINGS,
        *(recording(label, stiffness, 11 + i) for i, (label, stiffness) in enumerate(STIFFNESS.items())),
    ]
    asked = [fold for fold in folds(four) if fold.question == "another recording"]
    assert len(asked) == 4
    assert all(fold.tests[0][0] not in fold.training for fold in asked)
    found = cross_validate(four, LEARN, TOOL, SETTINGS.identification, lambda _: None)
    others = [each for each in found if each.question == "another recording"]
    assert len(others) == sum(len(each.grasps) for each in four)
    assert np.mean([each.label == each.truth for each in others if each.grasp > 1]) > 0.9


def test_slipping_encoders_are_not_learned_from():
    samples = pressed(0.3)
    samples["flags"] |= 64
    slipping = replace(RECORDINGS[0], grasps=(*RECORDINGS[0].grasps, RecordedGrasp(10, samples, PARAMETERS, None)))
    assert "slips" in extract_loading_curves(slipping, TOOL, 2.5).left_out[-1]
