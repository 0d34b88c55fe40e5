"""Reference grasps: measured on empty jaws, refused where they are none, and used as the zero of stall and stops."""

import json
import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from learned import learner, pressed
from simulation import cut, drive, write_lvm

from acquisition.drivers.source import RawBlock
from acquisition.protocol_player import ProtocolPlayer
from acquisition.recordings.recording import RecordingSource
from acquisition.sample_block import SampleFlag
from acquisition.signals.calibration import compute_sensor_signals_from_jaws
from acquisition.signals.pipeline import ConditioningPipeline
from acquisition.simulation.grasper import SimulatedGrasper
from app.analysis.learning.grasp_reader import check_reference_day, read_reference
from app.analysis.learning.library_file import library_to_toml
from app.recordings.answer_advice import explain_missing_reference
from config.errors import CalibrationError, ConfigurationError
from config.load import load_grasp_protocol, load_library, load_settings, load_tool, parse_file
from config.schema import ReferenceGrasp, SourceConditions, TissueLibrary
from estimator.learning.recorded_grasps import LabeledRecording, RecordedGrasp
from estimator.learning.reference_measurement import measure_reference
from estimator.loading.constants import FEATURES, REFERENCE_STALL_SD
from estimator.loading.learned_evidence import LearnedEvidence
from estimator.loading.loading_curve import OPENING, STALL, ObservedFeatures

SETTINGS, PORCINE = load_settings(), load_library("porcine")
PROTOCOL = load_grasp_protocol("reference_grasp")
DAY = datetime(2026, 11, 22, 9, tzinfo=UTC)
RIG = load_tool("smart_tool_2013")
LIVER_STALL_LOG = 0.06  # thicker tissue holds the jaws further open, where the motor presses harder


class KnownGrasper(SimulatedGrasper):
    """A simulated grasper that keeps the true strain over rest of every sample, V."""

    def __init__(self, *args) -> None:
        super().__init__(*args)
        self.strain_v: list[float] = []
        self.travel_deg: list[float] = []  # without the cable's stretch

    def step(self, command_v: float) -> dict[str, float]:
        result = super().step(command_v)
        self.strain_v.append(compute_sensor_signals_from_jaws(self._tool, *self._compute_handle_signals())[0])
        self.travel_deg.append(compute_sensor_signals_from_jaws(self._tool, 0.0, self.jaw_displacement_m)[1])
        return result


def tool_with(newton_per_volt: float, stretch: float):
    """Return the simulated tool with another strain gage and cable; its strain is as large as on the rig."""
    tool = load_tool("simulated")
    constants = {"newton_per_volt": newton_per_volt, "encoder_deg_per_volt": stretch}
    return tool.model_copy(update={"calibration": tool.calibration.model_copy(update=constants)})


def played(tool, tissue: str | None, cycles: int = 3) -> tuple[RawBlock, KnownGrasper]:
    player, commands = ProtocolPlayer(PROTOCOL, tool, cycles), []
    while not player.done:
        commands += [player.next_command(5)] * 5
    grasper = KnownGrasper(tool, PORCINE, tissue or "liver", 1)
    grasper.gauge_m = None if tissue else 0.0
    return drive(grasper, commands), grasper


def conditioned(raw: RawBlock, tool) -> np.ndarray:
    pipeline = ConditioningPipeline(tool, SETTINGS.conditioning)
    return np.concatenate([pipeline.process(block).samples for block in cut(raw, range(0, len(raw), 100))])


@pytest.fixture(scope="module")
def empty():
    tool = tool_with(0.8, 52.189)
    raw, grasper = played(tool, None)
    return tool, raw, conditioned(raw, tool), grasper


def test_stall_stretch_and_stops_come_out_within_one_percent(empty):
    tool, raw, samples, grasper = empty
    other = tool_with(0.5, 30.0)
    other_raw, other_grasper = played(other, None)
    for each, recorded, truth in ((tool, samples, grasper), (other, conditioned(other_raw, other), other_grasper)):
        found = measure_reference(recorded, each, DAY, "Ada")
        assert found.stall_v == pytest.approx(max(truth.strain_v), rel=0.01)
        assert found.stretch_deg_per_volt == pytest.approx(each.calibration.encoder_deg_per_volt, rel=0.01)
        assert found.opening_deg == pytest.approx(max(truth.travel_deg), rel=0.01)
        assert (found.grasps, found.person, found.command_v) == (3, "Ada", pytest.approx(2.0, rel=0.01))
        assert found.belongs_to(each, DAY + timedelta(hours=9))
        assert not found.belongs_to(each, DAY + timedelta(hours=23))
    assert not found.belongs_to(tool, DAY)  # another calibration
    stretched = tool_with(0.8, 45.0)  # a file that knows another cable
    assert measure_reference(conditioned(raw, stretched), stretched, DAY, None).stretch_deg_per_volt == pytest.approx(
        52.189, rel=0.01
    )


def test_what_is_no_reference_is_refused_with_what_to_do(empty):
    tool, raw, samples, _ = empty

    def refused(samples, words):
        with pytest.raises(CalibrationError, match=words) as told:
            measure_reference(samples, tool, DAY, None)
        assert str(told.value).endswith(".")
        assert "\n" not in str(told.value)

    for tissue in PORCINE.tissues:
        refused(conditioned(played(tool, tissue)[0], tool), "Empty t")
    refused(samples[samples["grasp"] < 3], "Of 2 grasps 2 can be used; a reference grasp needs 3")
    refused(samples[:100], "Of 0 grasps 0 can be used")
    slipping = dict(raw.signals) | {"encoder_deg": raw.signals["encoder_deg"] * 0.3}
    refused(conditioned(RawBlock(0, 0, slipping), tool), "encoder slips")
    for flag, words in (
        (SampleFlag.SATURATED, "gage is saturated"),
        (SampleFlag.LIMITED, "limiter held the motor back"),
    ):
        flagged = samples.copy()
        flagged["flags"][flagged["grasp"] == 2] |= flag.value
        refused(flagged, words)
    weaker = samples.copy()
    weaker["strain_v"][weaker["grasp"] == 2] *= 0.9
    refused(weaker, "grasps disagree")
    refused(samples[(samples["motor_command_v"] < 1.9) | (samples["grasp"] == 0)], "samples are missing")


def test_a_recording_is_a_reference_for_its_own_day(empty, tmp_path):
    _, raw, _, _ = empty
    tool = tool_with(0.8, 52.189)
    path = write_lvm(tmp_path / "empty.lvm", raw)
    found = read_reference(path, tool, SETTINGS)
    assert found.taken_at == datetime(2026, 11, 22, 10, tzinfo=UTC)
    check_reference_day(found, RecordingSource(path, tool))
    later = tmp_path / "later.lvm"
    later.write_text(path.read_text().replace("2026/11/22", "2026/11/24"))
    with pytest.raises(ConfigurationError, match=r"later\.lvm: was recorded on 2026-11-24 10:00, the ref"):
        check_reference_day(found, RecordingSource(later, tool))
    held = write_lvm(tmp_path / "liver.lvm", played(tool, "liver")[0])
    with pytest.raises(CalibrationError, match=r"liver\.lvm: is no reference grasp. The force rises"):
        read_reference(held, tool, SETTINGS)


# --- as the zero of stall and stops --------------------------------------------------------------------------------


def reference(stall_v: float = 2.5, opening_deg: float = 200.0, at: datetime = DAY, **changes) -> ReferenceGrasp:
    values = {
        "tool": RIG.name,
        "calibration": RIG.calibration_fingerprint,
        "taken_at": at,
        "person": "Ada",
        "grasps": 5,
    }
    values |= {"command_v": 2.0, "stall_v": stall_v, "stretch_deg_per_volt": 52.0, "shut_deg": opening_deg + 10.0}
    return ReferenceGrasp(**(values | {"open_deg": 10.0} | changes))


def library_of(conditions: SourceConditions) -> TissueLibrary:
    def recording(label, stiffness, seed):
        grasps = tuple(
            RecordedGrasp(
                i + 1, pressed(stiffness * (1 + 0.03 * i), seed=10 * seed + i), np.log([0.1, 500.0, 5.0]), None
            )
            for i in range(6)
        )
        return LabeledRecording(label, f"{label}.lvm", f"{seed:02x}" * 32, grasps, conditions)

    learned = learner(RIG, PORCINE)([recording("bladder", 0.08, 1), recording("liver", 0.6, 2)])
    content = learned.model_dump(mode="json")
    [liver] = content["tissues"]["liver"]["learned"]["recordings"]
    liver["centre"][STALL] += LIVER_STALL_LOG
    return TissueLibrary.model_validate_json(json.dumps(content))


def judged(library: TissueLibrary, conditions: SourceConditions, stall_log: float = 0.0, opening: float = 0.0):
    """Return the probabilities for features near liver, moved by another stall and opening."""
    at_home = LearnedEvidence(
        library, RIG, SETTINGS.identification, library.tissues["liver"].learned.recordings[0].conditions
    )
    bladder, liver, _ = at_home.predict_features(1.6, first=False)
    features = liver.mean + 0.25 * (bladder.mean - liver.mean)
    features[STALL] += stall_log + 0.02
    features[OPENING] += opening
    evidence = LearnedEvidence(library, RIG, SETTINGS.identification, conditions)
    observed = ObservedFeatures(features, np.zeros(len(FEATURES)), 1.6)
    return evidence.compute_posterior(observed, evidence.predict_features(1.6, first=False))


def test_reference_grasps_make_days_comparable_and_days_without_are_less_sure():
    then = SourceConditions(DAY, reference())
    library, weeks = library_of(then), DAY + timedelta(days=20)
    known = judged(library, then)
    for factor in (0.8, 1.0, 1.3):  # a drive that is weaker or stronger, with the same tissue
        now = SourceConditions(weeks, reference(2.5 * factor, 200.0 + 24.0, weeks))
        assert judged(library, now, math.log(factor), 2.0) == pytest.approx(known, rel=1e-9)
        scaled = library_of(SourceConditions(DAY, reference(2.5 * factor)))
        both = SourceConditions(weeks, reference(2.5 * factor, at=weeks))
        assert judged(scaled, both) == pytest.approx(known, rel=1e-9)
    bare, same_day = library_of(SourceConditions(DAY)), SourceConditions(DAY + timedelta(hours=11))
    assert np.array_equal(judged(bare, same_day), known)
    less = [
        judged(bare, SourceConditions(weeks)),
        judged(bare, SourceConditions(weeks, reference(at=weeks))),
        judged(bare, SourceConditions()),
        judged(library, SourceConditions(weeks)),
        judged(library, SourceConditions(weeks, reference(at=weeks, command_v=1.0))),
    ]
    for found in less:
        assert np.array_equal(found, less[0])
    evidence = [
        LearnedEvidence(bare, RIG, SETTINGS.identification, each) for each in (same_day, SourceConditions(weeks))
    ]
    near, far = (each.predict_features(1.6, first=False)[1].spot_covariance for each in evidence)
    added = np.zeros_like(near)
    added[STALL, STALL] = REFERENCE_STALL_SD**2
    assert far - near == pytest.approx(added, abs=1e-12)
    by_stall = np.full(len(FEATURES), np.nan)
    by_stall[STALL] = evidence[0].predict_features(1.6, first=False)[1].mean[STALL]
    observed = ObservedFeatures(by_stall, np.zeros(len(FEATURES)), 1.6)
    sure, unsure = (each.compute_posterior(observed, each.predict_features(1.6, first=False)) for each in evidence)
    assert sure[1] > unsure[1] + 0.02, (sure, unsure)
    assert sure[0] < unsure[0], (sure, unsure)


def test_a_library_keeps_its_references_and_one_of_before_stays_readable():
    library = library_of(SourceConditions(DAY, reference()))
    assert parse_file(library_to_toml(library), TissueLibrary, "kept").tissues == library.tissues
    text = library.model_dump_json(
        exclude={"tissues": {"__all__": {"learned": {"recordings": {"__all__": {"recorded_at", "reference"}}}}}}
    )
    before = TissueLibrary.model_validate_json(text)
    assert before.tissues["liver"].learned.recordings[0].conditions == SourceConditions()
    told = explain_missing_reference(RIG, before, SourceConditions(DAY))
    assert "2 recordings of the library 'learned' are of another day (not known; this one: 2026-11-22)" in told
    assert told.endswith("on a live tool, take a reference grasp first.")
    by_hand = explain_missing_reference(load_tool("arthroscopic_punch"), before, SourceConditions(DAY))
    assert by_hand.endswith("with empty jaws of that day with --reference.")
    assert explain_missing_reference(RIG, library, SourceConditions(DAY)) is None
    assert explain_missing_reference(RIG, PORCINE, SourceConditions(DAY)) is None
