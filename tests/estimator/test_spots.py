"""Spot verdicts: what several grasps on one place say together."""

import numpy as np
import pytest
from grasps import by, conditioned, processed
from learned import learner, pressed

from acquisition.sample_block import SampleFlag
from config.load import load_grasp_protocol, load_library, load_settings, load_tool
from estimator.decision import NO_ANSWER
from estimator.evidence import BankEvidence
from estimator.filter_bank import ContactStart, FilterBank
from estimator.learning.recorded_grasps import LabeledRecording, RecordedGrasp
from estimator.loading.constants import FEATURES
from estimator.loading.learned_evidence import LearnedEvidence
from estimator.loading.loading_curve import ObservedFeatures
from estimator.online_estimator import TissueEstimator
from estimator.spots import LearnedSpot

TOOL, LIBRARY, SETTINGS = load_tool("simulated"), load_library("porcine"), load_settings()
RIG = load_tool("smart_tool_2013")
FAST = load_grasp_protocol("trapezoid_2hz")


def learned_library():
    def recording(label, stiffness, seed):
        rng = np.random.default_rng(seed)
        grasps = tuple(
            RecordedGrasp(
                i + 1,
                pressed(stiffness * np.exp(rng.normal(0, 0.1)), gap_deg=120.0 + rng.normal(0, 4), seed=100 * seed + i),
                np.log([0.1, 500.0, 5.0]) + rng.normal(0, 0.2, 3),
                None,
            )
            for i in range(9)
        )
        return LabeledRecording(label, f"{label}{seed}.lvm", f"{seed:02x}" * 32, grasps)

    return learner(RIG, LIBRARY)([recording("bladder", 0.08, 1), recording("liver", 0.6, 2)])


EVIDENCE = LearnedEvidence(learned_library(), RIG, SETTINGS.identification)
PREDICTIONS = EVIDENCE.predict_features(1.6, first=False)


def of_mean(features, grasps):
    observed = ObservedFeatures(features, np.zeros(len(FEATURES)), 1.6)
    return EVIDENCE.compute_posterior(observed, PREDICTIONS, grasps)


def test_more_grasps_on_one_spot_never_make_sure_what_one_spot_cannot_tell():
    bladder, liver, _ = PREDICTIONS
    between = bladder.mean + 0.45 * (liver.mean - bladder.mean)  # a spot like either
    one, many, exact = (of_mean(between, grasps) for grasps in (1, 100, 1e9))
    assert many.max() < SETTINGS.identification.decide_at
    assert many == pytest.approx(exact, abs=0.02)  # the spot's own deviation is what is left
    product = one**5 / (one**5).sum()  # as if five grasps were five spots
    assert of_mean(between, 5).max() < max(product.max(), one.max()) + 0.05


def test_the_verdict_of_one_grasp_is_that_grasps_answer():
    samples = pressed(0.6, seed=50)
    grasp, spot = EVIDENCE.start_grasp(None, first=False), LearnedSpot(EVIDENCE)
    answer = grasp.process(samples)
    assert spot.append(grasp)
    assert spot.probabilities() == pytest.approx(answer)


def test_a_spots_first_grasp_counts_until_there_is_another_one():
    spot = LearnedSpot(EVIDENCE)
    first = EVIDENCE.start_grasp(None, first=True)
    answer = first.process(pressed(0.08, seed=51))
    spot.append(first)
    assert spot.probabilities() == pytest.approx(answer)
    for seed in (52, 53):
        later = EVIDENCE.start_grasp(None, first=False)
        later.process(pressed(0.6, seed=seed))
        spot.append(later)
    assert spot.probabilities().argmax() == 1  # liver, as the later ones


def bank_evidence(seed=0):
    rng = np.random.default_rng(seed)
    strain = rng.normal(0, 0.002, 200)
    force, x = np.linspace(0, 1.0, 200) + 7 * strain, np.linspace(0, 1.5e-3, 200) - 6e-3 * strain
    samples = np.column_stack([force, x, np.full(200, 7.0), np.full(200, -6e-3), np.full(200, 1e-3)])
    bank = FilterBank.from_tool(TOOL, LIBRARY)
    bank.start(ContactStart(samples[0]))
    bank.advance(samples[1:])
    return BankEvidence(bank, LIBRARY, SETTINGS.identification)


def test_with_filters_one_grasp_makes_the_spots_answer_and_more_make_it_surer_within_the_prior():
    evidence = bank_evidence()
    one = evidence.measure_likelihood()
    assert evidence.combine_grasps([]) == pytest.approx(evidence.prior)
    # each grasp scatters about its spot, and the spot's spread is as much smaller: together the grasp's own spread
    assert evidence.combine_grasps([one]) == pytest.approx(evidence.probabilities(), abs=1e-6)
    many, more = evidence.combine_grasps([one] * 20), evidence.combine_grasps([one] * 2000)
    assert more == pytest.approx(many, abs=0.02)  # the limit is the spread of specimens


@pytest.fixture(scope="module")
def samples():
    return conditioned(TOOL, LIBRARY, SETTINGS, FAST, "bladder", seed=3, cycles=3)[0]


def spots_of(samples, settings=SETTINGS):
    blocks, _ = processed(TissueEstimator(TOOL, LIBRARY, settings), samples, by(samples, 5))
    return blocks[-1].identification.spots


@pytest.mark.parametrize("tissue", list(LIBRARY.tissues))
def test_the_verdict_after_a_simulated_grasp_is_that_grasps_answer(tissue):
    held = conditioned(TOOL, LIBRARY, SETTINGS, FAST, tissue, seed=3, cycles=1)[0]
    blocks, [record] = processed(TissueEstimator(TOOL, LIBRARY, SETTINGS), held, by(held, 5))
    (spot,) = blocks[-1].identification.spots
    assert spot.probabilities == pytest.approx(record.probabilities, abs=1e-3)


def test_grasps_of_a_run_are_one_spot_unless_told_otherwise(samples):
    (spot,) = spots_of(samples)
    assert (spot.index, spot.grasps, spot.label) == (1, (1, 2, 3), "bladder")
    assert spot.probability == spot.probabilities["bladder"] > 0.95


def test_a_grasp_under_way_belongs_to_the_spot_before(samples):
    changed = samples.copy()
    in_second = np.flatnonzero(samples["grasp"] == 2)
    changed["flags"][in_second[50]] |= np.uint16(SampleFlag.NEW_SPOT)
    first, second = spots_of(changed)
    assert (first.grasps, second.grasps) == ((1, 2), (3,))
    assert first.began_s < second.began_s


def test_a_spot_that_begins_between_two_grasps_begins_there(samples):
    changed = samples.copy()
    rest = int(np.flatnonzero((samples["grasp"] == 1) & (samples["flags"] & SampleFlag.IN_GRASP == 0))[20])
    changed["flags"][rest] |= np.uint16(SampleFlag.NEW_SPOT)
    first, second = spots_of(changed)
    assert (first.grasps, second.grasps) == ((1,), (2, 3))
    assert second.began_s == pytest.approx(samples["tick"][rest] / 1000, abs=0.01)


def test_jaws_that_stay_open_for_longer_than_stated_begin_a_new_spot(samples):
    short = SETTINGS.identification.model_copy(update={"new_spot_after_s": 0.05})
    spots = spots_of(samples, SETTINGS.model_copy(update={"identification": short}))
    assert [spot.grasps for spot in spots] == [(1,), (2,), (3,)]


def test_a_spot_whose_encoder_slips_has_no_answer(samples):
    changed = samples.copy()
    changed["flags"][samples["grasp"] > 0] |= np.uint16(SampleFlag.ENCODER_SLIPS)
    (spot,) = spots_of(changed)
    assert (spot.label, spot.grasps, spot.probability) == (NO_ANSWER, (), None)
