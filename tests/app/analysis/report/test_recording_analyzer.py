"""A story tells the same as a replay, and where in it each grasp is."""

import json

import numpy as np
import pytest
from reports import simulated_story
from simulation import joined, simulate_raw, write_lvm

from app.analysis.headless import replay_recording
from app.analysis.report.recording_analyzer import analyze_recording, open_recorded_run
from app.analysis.report.report import Report, analyze_recordings
from app.analysis.report.stress_strain import build_curve
from app.recordings.mcap_writer import RecordingContext
from config.errors import RecordingError
from estimator.force_alarms import Priority


def test_a_recording_s_story_has_the_grasps_of_its_replay(tmp_path, recording_tool, library, settings):
    path = write_lvm(tmp_path / "gallbladder.lvm", joined(simulate_raw("gallbladder", cycles=2)))
    shares = []
    story = analyze_recording(open_recorded_run(path, recording_tool), "a title", library, settings, shares.append)
    replayed = replay_recording(
        open_recorded_run(path, recording_tool), RecordingContext(recording_tool, library, settings), lambda _: None
    )
    assert [*story.grasps] == replayed.grasps
    assert (story.title, len(story.traces), story.tissue) == ("a title", replayed.samples, None)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_each_grasp_has_its_samples_and_its_force_errors():
    story = simulated_story("gallbladder")
    assert [grasp.index for grasp in story.grasps] == [1, 2, 3]
    for grasp in story.grasps:
        rows = story.grasp_traces(grasp)
        assert rows["tick"][0] == round(grasp.start_s * story.rate_hz)
        assert len(rows) == pytest.approx((grasp.end_s - grasp.start_s) * story.rate_hz, abs=1)
        assert rows["jaw_force_filtered_n"].max() == pytest.approx(grasp.peak_force_n, rel=1e-5)
        low, high = story.force_errors_n(grasp)["gallbladder"]
        assert low <= grasp.force_error_n["gallbladder"] <= high


def test_the_thickness_measured_at_contact_is_kept():
    story = simulated_story("liver")
    assert [*story.thickness_m] == [1, 2, 3]
    assert all(0.003 < thickness_m < 0.02 for thickness_m in story.thickness_m.values())


def test_too_strong_grasps_have_their_highest_warning_each():
    story = simulated_story("gallbladder", cycles=2, protocol="strong_2hz")
    for grasp in story.grasps:
        alarms = story.grasp_alarms(grasp)
        assert alarms
        assert all(grasp.start_s <= alarm.tick / story.rate_hz <= grasp.end_s for alarm in alarms)
        assert Priority.HIGH in [alarm.priority for alarm in alarms]


def test_the_measured_curve_lies_near_the_estimated_one():
    story = simulated_story("liver")
    for grasp in story.grasps:
        curve = build_curve(story, grasp)
        assert len(curve.strain) == len(curve.measured_kpa) == len(curve.estimated_kpa)
        assert np.nanmedian(np.abs(curve.measured_kpa - curve.estimated_kpa)) < 0.05 * curve.measured_kpa.max()


def test_a_report_groups_by_label_then_by_the_recording_s_word():
    story = simulated_story("bladder")
    assert [*Report("r", (story,), {}).statistics.groups] == ["bladder"]
    assert [*Report("r", (story,), {"bladder": "liver"}).statistics.groups] == ["liver"]


def test_progress_rises_over_all_files_and_a_bad_one_is_told_by_its_name(tmp_path, recording_tool, library, settings):
    good = write_lvm(tmp_path / "good.lvm", joined(simulate_raw("liver", "trapezoid_4hz")))
    (tmp_path / "bad.lvm").write_text("LabVIEW Measurement\n")
    shares = []
    report = analyze_recordings([good], recording_tool, library, settings, {good: "liver"}, shares.append)
    assert shares == sorted(shares)
    assert report.labels == {"good.lvm": "liver"}
    with pytest.raises(RecordingError, match=r"bad\.lvm"):
        analyze_recordings([good, tmp_path / "bad.lvm"], recording_tool, library, settings, {}, shares.append)


def test_the_document_has_no_number_that_json_has_not():
    document = Report("Report: two", (simulated_story("liver"), simulated_story("bladder")), {}).document()
    text = json.dumps(document, allow_nan=False)
    assert [one["title"] for one in json.loads(text)["recordings"]] == ["liver", "bladder"]
    assert {pair["pair"][1] for pair in document["tukey"]["alpha"]["pairs"]} == {"bladder"}
