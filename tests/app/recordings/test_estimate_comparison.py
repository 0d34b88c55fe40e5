"""A replay gives bit for bit the estimates of the run, or says what is different."""

from pathlib import Path

import pytest

from acquisition.recordings.recording import RecordingSource
from app.analysis.headless import replay_recording
from app.recordings.mcap_writer import RecordingContext
from config.load import load_settings, load_tool

LABVIEW = load_tool("smart_tool_2013")


def replayed(path: Path, **changes):
    recording = RecordingSource(path, LABVIEW)
    rig = RecordingContext.from_recording(recording.mcap_file)
    settings = load_settings()
    for part, values in changes.items():
        settings = settings.model_copy(update={part: getattr(settings, part).model_copy(update=values)})
    report = replay_recording(recording, RecordingContext(rig.tool, rig.library, settings), lambda _: None)
    return report, report.comparison


def test_with_the_same_configuration_all_is_equal(recorded: Path) -> None:
    report, comparison = replayed(recorded)
    assert comparison.compared_samples == report.samples
    assert comparison.unequal_samples == 0
    assert comparison.differences == []
    assert "bit for bit" in comparison.text()


def test_with_another_one_it_says_what_differs_and_from_where_on(recorded: Path) -> None:
    _, comparison = replayed(recorded, identification={"prior_unknown": 0.2})
    assert comparison.differences == ["settings identification prior_unknown: recorded with 0.05, now 0.2"]
    assert comparison.unequal_samples > 0
    assert comparison.first_unequal in comparison.text()


def test_what_does_not_matter_for_estimates_is_no_difference(recorded: Path) -> None:
    _, comparison = replayed(recorded, server={"port": 1})
    assert comparison.differences == []
    assert comparison.unequal_samples == 0


@pytest.mark.parametrize("speed", [1000.0])
def test_the_cut_into_blocks_does_not_matter(recorded: Path, speed: float) -> None:
    recording = RecordingSource(recorded, LABVIEW, speed)
    report = replay_recording(recording, RecordingContext.from_recording(recording.mcap_file), lambda _: None)
    assert report.comparison.compared_samples == report.samples
    assert report.comparison.unequal_samples == 0
