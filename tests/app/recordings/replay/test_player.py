"""What a replay shows, and when: the film of a recording, and the head that plays it."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulation import cut, joined, lvm_text, simulate_raw

from acquisition.recordings.labview import read_lvm
from acquisition.recordings.recording import RecordingSource
from app.analysis.headless import replay_recording
from app.messages.live import ReplayControl
from app.recordings.mcap_writer import RecordingContext
from app.recordings.replay import cache_builder
from app.recordings.replay.cache_builder import build_replay_cache
from app.recordings.replay.playhead import Playhead
from app.recordings.replay.replay_cache import ReplayCache
from app.stream.frames import build_channels
from config.errors import RecordingError, ServiceError
from config.load import load_library, load_settings, load_tool

TOOL, LIBRARY, SETTINGS = load_tool("simulated"), load_library("porcine"), load_settings()
GAP, END = range(1400, 1503), 3400  # ticks between two grasps, and in the third


@pytest.fixture(scope="session")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three grasps over a bladder's threshold: 103 samples are missing after the first, the third is cut short."""
    path = tmp_path_factory.mktemp("film") / "strong.lvm"
    whole = joined(simulate_raw("bladder", "strong_2hz", seed=2, cycles=3))
    before, _, after, _ = cut(whole, [GAP.start, GAP.stop, END])
    rows = lvm_text(after).splitlines()
    headings = next(i for i, row in enumerate(rows) if row.startswith("X_Value"))
    path.write_text(lvm_text(before) + "\n".join(rows[headings + 1 :]) + "\n")
    return path


@pytest.fixture(scope="session")
def film(path: Path, tmp_path_factory: pytest.TempPathFactory) -> ReplayCache:
    folder = tmp_path_factory.mktemp("film")
    shares: list[float] = []
    build_replay_cache(shares.append, path, TOOL, LIBRARY, SETTINGS, folder)
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0, abs=0.03)
    film = ReplayCache.open(folder)
    for file in folder.iterdir():  # as the service does: the film needs no names
        file.unlink()
    return film


def told(film: ReplayCache, begin: int, end: int, kind: str) -> list[dict[str, Any]]:
    messages = [json.loads(message) for message in film.messages(begin, end)]
    return [message for message in messages if message["type"] == kind]


def so_far(film: ReplayCache, tick: int, kind: str) -> list[dict[str, Any]]:
    return [message for message in map(json.loads, film.initial_messages(tick)) if message["type"] == kind]


# --- the film ---------------------------------------------------------------------------------------------------------


def test_a_film_has_every_sample_of_the_recording_with_its_estimates(film: ReplayCache, path: Path) -> None:
    table = read_lvm(path, TOOL)
    pieces = film.samples(0, film.end_tick)
    assert [tick for tick, _ in pieces] == [0, GAP.stop]
    columns = np.concatenate([columns for _, columns in pieces], axis=1)
    of = {(channel.name, channel.tissue): columns[i] for i, channel in enumerate(build_channels(list(LIBRARY.tissues)))}
    assert np.array_equal(of["strain_v", None], table[:, 1].astype(np.float32))
    assert np.array_equal(of["motor_command_v", None], table[:, 2].astype(np.float32))
    held = np.isfinite(of["alpha_n", "bladder"])
    assert 0.3 < held.mean() < 0.8
    assert of["probability", "bladder"][held][-1] > 0.95
    assert np.isfinite(of["threshold_n", None]).all()


@pytest.mark.parametrize("begin", [0, 1399, 1400, 1450, 1502, 1503, 1504, END - 1])
@pytest.mark.parametrize("ticks", [0, 1, 33, 200])
def test_any_stretch_gives_the_samples_that_are_there(film: ReplayCache, begin: int, ticks: int) -> None:
    end = min(begin + ticks, END)
    shown = [tick + i for tick, columns in film.samples(begin, end) for i in range(columns.shape[1])]
    assert shown == [tick for tick in range(begin, end) if tick not in GAP]
    assert film.lost_samples(end) == len([tick for tick in range(end) if tick in GAP])


def test_its_grasps_are_those_of_the_headless_replay_the_one_that_the_end_cut_short_included(
    film: ReplayCache, path: Path
) -> None:
    report = replay_recording(RecordingSource(path, TOOL), RecordingContext(TOOL, LIBRARY, SETTINGS), lambda _: None)
    grasps = [message["grasp"] for message in told(film, 0, END, "grasp")]
    assert len(grasps) == 3
    for grasp, record in zip(grasps, report.grasps, strict=True):
        assert record.model_dump().items() <= grasp.items()
    assert grasps[0]["alarms"] == ["high"]
    assert film.grasp_starts_s == [record.start_s for record in report.grasps]
    assert film.duration_s == END / 1000


def test_what_is_known_of_a_sample_is_told_with_it_not_before_and_soon(film: ReplayCache) -> None:
    for begin, end in pairwise(range(0, END + 1, 100)):
        for message in told(film, begin, end, "identification"):
            assert begin <= message["tick"] < end
            assert message["server_time_ms"] == message["tick"]  # at 1 kHz
    answers = told(film, 0, END, "identification")
    began = next(message for message in answers if message["in_grasp"])
    assert 0.0 <= began["tick"] / 1000 - film.grasp_starts_s[0] < 0.05
    assert sum(message["in_grasp"] for message in answers) >= 10 * 3 * 0.4  # ten times a second


def test_who_comes_in_the_middle_of_a_grasp_is_told_how_it_stands(film: ReplayCache) -> None:
    moment = round(1000 * film.grasp_starts_s[1]) + 400
    [identification] = so_far(film, moment, "identification")
    assert (identification["grasp"], identification["in_grasp"], identification["label"]) == (2, True, "bladder")
    assert 0 < moment - identification["tick"] <= 100
    assert [message["grasp"]["index"] for message in so_far(film, moment, "grasp")] == [1]
    force = [alarm for alarm in so_far(film, moment, "alarm") if alarm["kind"] == "force"]
    assert [alarm["priority"] for alarm in force if alarm["active"]] == ["high"]  # beside peaks that nobody has seen
    assert film.initial_messages(0) == []


def test_an_alarm_of_a_film_can_never_be_taken_for_one_of_the_live_tool(film: ReplayCache) -> None:
    ids = {alarm["id"] for alarm in told(film, 0, END, "alarm")}
    assert ids
    assert all(alarm_id.startswith("replay-") for alarm_id in ids)


def test_missing_samples_are_told_where_they_are_missing(film: ReplayCache) -> None:
    assert film.technical_alarm_texts(GAP.stop) == []
    assert film.technical_alarm_texts(GAP.stop + 50) == ["103 samples are missing from the recording so far"]
    [alarm] = [alarm for alarm in told(film, 0, END, "alarm") if alarm["kind"] == "technical"]
    assert GAP.stop <= alarm["began_ms"] < GAP.stop + 50


def test_a_broken_recording_names_its_line_and_not_the_servers_folders(tmp_path: Path, path: Path) -> None:
    broken = tmp_path / "broken.lvm"
    broken.write_text("\n".join([*path.read_text().splitlines()[:1000], "0.976000\t0.82"]))
    with pytest.raises(RecordingError, match=r"^broken\.lvm, line 1001: expected 6 columns, found 2"):
        build_replay_cache(print, broken, TOOL, LIBRARY, SETTINGS, tmp_path)


def test_a_film_that_would_fill_the_disk_is_not_made(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache_builder, "RESERVED_DISK_SHARE", 1.0)
    with pytest.raises(ServiceError, match="Make room"):
        build_replay_cache(print, path, TOOL, LIBRARY, SETTINGS, tmp_path)


# --- the head ---------------------------------------------------------------------------------------------------------


def head() -> Playhead:
    """At the beginning of ten seconds."""
    return Playhead(end_tick=10_000, rate_hz=1000.0)


@pytest.mark.parametrize("speed", [0.25, 1.0, 10.0])
def test_it_plays_as_fast_as_asked(speed: float) -> None:
    playing = head()
    assert not playing.apply_control(ReplayControl(speed=speed))
    assert playing.advance(0.4) == (0, 400 * speed)
    assert playing.advance(0.1) == (400 * speed, 500 * speed)


def test_paused_it_stays_where_it_is_and_then_goes_on() -> None:
    playing = head()
    playing.advance(1.0)
    assert not playing.apply_control(ReplayControl(playing=False))
    assert playing.advance(5.0) == (1000, 1000)
    assert not playing.apply_control(ReplayControl(playing=True))
    assert playing.advance(0.5) == (1000, 1500)


def test_it_jumps_where_it_is_told_to_and_not_past_the_end() -> None:
    playing = head()
    assert playing.apply_control(ReplayControl(position_s=0.29))
    assert playing.advance(0.01) == (290, 300)
    assert playing.apply_control(ReplayControl(position_s=1e300))
    assert playing.position_s == 10.0
    assert playing.advance(0.1) == (10_000, 10_000)


def test_at_the_end_it_pauses_and_to_play_there_begins_anew() -> None:
    playing = head()
    playing.apply_control(ReplayControl(position_s=9.9))
    assert playing.advance(0.5) == (9_900, 10_000)
    assert (playing.playing, playing.position_s) == (False, 10.0)
    assert playing.apply_control(ReplayControl(playing=True))
    assert playing.playing
    assert playing.advance(0.1) == (0, 100)


CONTROLS = st.builds(
    ReplayControl,
    playing=st.none() | st.booleans(),
    position_s=st.none() | st.floats(0.0, 1.2 * END / 1000),
    speed=st.none() | st.floats(0.25, 10.0),
)


@given(st.lists(CONTROLS | st.floats(0.0, 0.25), max_size=60))
def test_between_two_jumps_samples_follow_each_other_and_nothing_is_told_twice_or_forgotten(
    film: ReplayCache, steps: list[ReplayControl | float]
) -> None:
    playing = Playhead(film.end_tick, film.rate_hz)
    since, shown, messages = 0, [], []

    def check() -> None:
        assert shown == [tick for tick in range(since, playing.shown_tick) if tick not in GAP]
        assert messages == film.messages(since, playing.shown_tick)
        assert playing.shown_tick == pytest.approx(1000 * playing.position_s, abs=1.01)

    for step in steps:
        if isinstance(step, float):
            begin, end = playing.advance(step)
            shown += [tick + i for tick, columns in film.samples(begin, end) for i in range(columns.shape[1])]
            messages += film.messages(begin, end)
            continue
        before = playing.shown_tick
        if playing.apply_control(step):
            since, shown, messages = playing.shown_tick, [], []
        else:
            assert playing.shown_tick == before
        check()
    check()
