"""Libraries learned from the real recordings, on real recordings of another ramp that they have not seen."""

import re

import numpy as np
import pytest
from grasps import by, processed
from learned import gathered, learner

from acquisition.recordings.recording import RecordingSource
from acquisition.signals.pipeline import ConditioningPipeline
from app.analysis.headless import replay_recording
from app.recordings.mcap_writer import RecordingContext
from config.load import load_library, load_settings, load_tool
from estimator.online_estimator import TissueEstimator

pytestmark = pytest.mark.recordings
TOOL, BASE, SETTINGS = load_tool("smart_tool_2013"), load_library("porcine"), load_settings()
SHARED = ("liver", "bladder", "gallbladder")


@pytest.fixture(scope="module")
def by_name(recordings):
    return {path.name.split(".")[0]: path for path in recordings}


def label_of(name: str) -> str:
    return re.match("[a-z]+", name)[0]


@pytest.fixture(scope="module")
def libraries(by_name):
    """Learned from one recording a tissue at either ramp, and from both."""

    def learned(*names):
        files = {}
        for name in names:
            files.setdefault(label_of(name), []).append(by_name[name])
        return learner(TOOL, BASE)(gathered(files, TOOL, BASE, SETTINGS))

    fast, slow = ([f"{tissue}{ramp}Hz1" for tissue in SHARED] for ramp in ("4", "025"))
    return {"4": learned(*fast), "025": learned(*slow), "both": learned(*fast, *slow, "smallbowel025Hz1")}


@pytest.fixture(scope="module")
def answers(by_name, libraries):
    def answer(library, name):
        path = by_name[name]
        rig = RecordingContext(TOOL, libraries[library], SETTINGS)
        return replay_recording(RecordingSource(path, TOOL), rig, lambda _: None).grasps

    return answer


@pytest.mark.parametrize("name", ["liver025Hz2", "bladder4Hz2", "gallbladder4Hz2"])
def test_a_spot_that_was_not_learned_is_told_and_never_wrong(by_name, libraries, name):
    rig = RecordingContext(TOOL, libraries["both"], SETTINGS)
    (spot,) = replay_recording(RecordingSource(by_name[name], TOOL), rig, lambda _: None).spots
    assert max(spot.probabilities, key=spot.probabilities.get) == label_of(name)
    assert spot.label in (label_of(name), "undecided")
    assert len(spot.grasps) >= 8


def share_likeliest(grasps, tissue):
    return np.mean([max(grasp.probabilities, key=grasp.probabilities.get) == tissue for grasp in grasps])


@pytest.mark.parametrize(("learned_at", "asked_at"), [("4", "025"), ("025", "4")])
def test_the_likeliest_tissue_is_right_at_a_ramp_that_was_never_learned(answers, learned_at, asked_at):
    """Measured: 0.91 and 0.96 in the mean of the tissues. Forests on the same numbers: 0.71 and 0.67."""
    shares = []
    for tissue in SHARED:
        grasps = answers(learned_at, f"{tissue}{asked_at}Hz1")
        shares.append(share_likeliest(grasps, tissue))
        assert {grasp.label for grasp in grasps} <= {tissue, "undecided"}  # not sure, and never wrong
    assert np.mean(shares) >= 0.85
    assert min(shares) >= 0.7


@pytest.mark.parametrize("tissue", SHARED)
@pytest.mark.parametrize("ramp", ["4", "025"])
def test_known_recordings_are_named_right(answers, tissue, ramp):
    grasps = answers("both", f"{tissue}{ramp}Hz1")
    assert {grasp.label for grasp in grasps} <= {tissue, "undecided"}
    # a known recording counts as another spot of its tissue: bladder at 0.25 Hz scatters most, the others reach 0.88
    assert np.mean([grasp.label == tissue for grasp in grasps]) >= (
        0.6 if (tissue, ramp) == ("bladder", "025") else 0.75
    )
    # the filters follow; of gallbladder at 0.25 Hz three of 17 diverge, and state no parameters
    assert np.mean([grasp.alpha_n is not None for grasp in grasps]) >= 0.8


@pytest.mark.parametrize("ramp", ["4", "025"])
@pytest.mark.parametrize("library", ["4", "025", "both"])
def test_a_ureter_with_a_slipping_encoder_gets_no_answer_and_is_never_named_on_the_way(
    by_name, libraries, library, ramp
):
    session, pipeline, labels = (
        TissueEstimator(TOOL, libraries[library], SETTINGS),
        ConditioningPipeline(TOOL, SETTINGS.conditioning),
        set(),
    )
    records = []
    with RecordingSource(by_name[f"ureter{ramp}Hz1"], TOOL) as recording:
        while (raw := recording.read_block()) is not None:
            answer = session.process(pipeline.process(raw))
            labels.add(answer.identification.label)
            records += answer.ended
    assert labels <= {"no_answer", "undecided"}
    assert {record.label for record in records} == {"no_answer"}
    assert all(not record.valid for record in records)


def test_a_learned_library_answers_alike_whatever_the_size_of_blocks(by_name, libraries):
    pipeline, blocks = ConditioningPipeline(TOOL, SETTINGS.conditioning), []
    with RecordingSource(by_name["gallbladder4Hz1"], TOOL) as recording:
        while len(blocks) < 30 and (raw := recording.read_block()) is not None:
            blocks.append(pipeline.process(raw).samples)
    samples = np.concatenate(blocks)
    told = []
    for size in (5, 10, 100):
        answer, records = processed(TissueEstimator(TOOL, libraries["both"], SETTINGS), samples, by(samples, size))
        told.append(
            (np.concatenate([block.estimates for block in answer]).tobytes(), [r.probabilities for r in records])
        )
    assert told[0] == told[1] == told[2]


def test_names_come_before_the_force_is_held(answers):
    """At 4 Hz the force is held half a second after the command; the wall is met after 0.35 s."""
    for tissue in SHARED:
        grasps = answers("both", f"{tissue}4Hz1")
        times = [g.contact_s + g.time_to_decision_s - g.start_s for g in grasps if g.time_to_decision_s is not None]
        assert np.median(times) < 0.56
