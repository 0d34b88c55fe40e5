"""Recordings watched through the real service: by several viewers, beside a tool at work."""

import json
import os
import shutil
import signal
import time
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
from service import Listener, Service, until
from simulation import joined, simulate_raw, simulated_recording_tool, write_lvm
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from acquisition.recordings.labview import read_lvm
from acquisition.recordings.recording import RecordingSource
from app.analysis.headless import replay_recording
from app.recordings.mcap_writer import RecordingContext
from config.load import CONFIG_DIR, load_library, load_settings, load_tool

RIG, LIBRARY, SETTINGS = load_tool("smart_tool_2013"), load_library("porcine"), load_settings()
CYCLES, NAME = 8, "bladder.lvm.gz"
LIVE, HISTORY = 0, 1


@pytest.fixture(scope="module")
def service():
    with Service("serve") as running:
        folder = running.data / "recordings"
        raw = joined(simulate_raw("bladder", cycles=CYCLES, tool=simulated_recording_tool()))
        write_lvm(folder / NAME, raw)
        lines = write_lvm(folder / "whole.lvm", raw).read_text().splitlines()
        (folder / "whole.lvm").unlink()
        (folder / "broken.lvm").write_text("\n".join([*lines[:1000], "0.976000\t0.82"]))
        yield running


@pytest.fixture(scope="module")
def path(service):
    return service.data / "recordings" / NAME


@contextmanager
def watching(service, name=NAME, **control):
    """A viewer that was greeted, and asks for something then."""
    with Listener(service, f"/api/recordings/{name}/replay") as viewer:
        viewer.send(type="replay", **control)
        viewer.listen(lambda: any(state["prepared"] == 1.0 for state in viewer.of("replay_state")), 90.0)
        yield viewer


def listen_for(viewer, seconds):
    end = time.monotonic() + seconds
    viewer.listen(lambda: time.monotonic() > end)


def jump(viewer, **control):
    """What the viewer gets from the greeting after a jump on: messages and frames."""
    greetings, frames = len(viewer.of("hello")), len(viewer.frames)
    viewer.send(type="replay", **control)
    viewer.listen(lambda: len(viewer.of("hello")) > greetings and viewer.messages[-1]["type"] == "replay_state")
    viewer.listen(lambda: any(h[1] == HISTORY for h, _ in viewer.frames[frames:]))
    begin = [i for i, message in enumerate(viewer.messages) if message["type"] == "hello"][-1]
    return viewer.messages[begin:], viewer.frames[frames:]


def ticks(frames, kind=LIVE):
    """First tick and the one after the last, of each frame."""
    return [(int(h[6]), int(h[6]) + columns.shape[1]) for h, columns in frames if h[1] == kind]


def follow_each_other(pieces):
    return all(end == begin for (_, end), (begin, _) in pairwise(pieces))


def at_its_end(viewer):
    """It pauses there, and the last frame, which messages may overtake, has come."""
    state = viewer.of("replay_state")[-1]
    ended = not state["playing"] and state["position_s"] == state["duration_s"]
    return ended and any(end == round(1000 * state["duration_s"]) for _, end in ticks(viewer.frames))


def closed(connection):
    """The last message before the connection is closed; code and reason of the close."""
    message = None
    with pytest.raises(ConnectionClosed) as caught:
        while True:
            message = json.loads(connection.recv(timeout=60))
    return message, caught.value.rcvd.code, caught.value.rcvd.reason


@pytest.mark.long
def test_at_ten_times_its_speed_every_sample_comes_once_and_the_grasps_are_those_of_a_headless_replay(service, path):
    with watching(service, speed=10) as viewer:
        viewer.listen(lambda: at_its_end(viewer))
        told = viewer.messages
    first = next(i for i, message in enumerate(told) if message["type"] == "hello")
    assert {message["type"] for message in told[:first]} == {"replay_state"}
    assert all(not message["playing"] and message["prepared"] < 1.0 for message in told[:first])
    assert told[first]["tool"]["kind"] == "recording"
    table = read_lvm(path, RIG)
    assert ticks(viewer.frames)[0][0] == 0
    assert follow_each_other(ticks(viewer.frames))
    strain_v = np.concatenate([columns[0] for _, columns in viewer.frames])
    assert np.array_equal(strain_v, table[:, 1].astype(np.float32))
    report = replay_recording(RecordingSource(path, RIG), RecordingContext(RIG, LIBRARY, SETTINGS), lambda _: None)
    grasps = [message["grasp"] for message in viewer.of("grasp")]
    assert len(grasps) == CYCLES
    assert [(g["label"], g["probabilities"]) for g in grasps] == [(g.label, g.probabilities) for g in report.grasps]
    assert all(message["run_id"] is None for message in viewer.of("grasp"))
    assert viewer.of("replay_state")[-1]["grasps"] == [grasp.start_s for grasp in report.grasps]
    assert {message["phase"] for message in viewer.of("state")} == {"replay"}


def test_it_plays_as_time_goes_and_its_clock_is_its_position(service):
    with watching(service) as viewer:
        begin = viewer.of("replay_state")[-1]["position_s"]
        listen_for(viewer, 2.0)
        end = viewer.of("replay_state")[-1]["position_s"]
        assert end - begin == pytest.approx(2.0, abs=0.3)
        for header, columns in viewer.frames:
            assert header[7] == header[6] + columns.shape[1] - 1  # the newest sample, ms
        assert viewer.of("state")[-1]["server_time_ms"] == pytest.approx(1000 * end, abs=1100)


def test_a_jump_into_the_middle_of_a_grasp_shows_what_was_known_then(service):
    with watching(service, playing=False) as viewer:
        start_s = viewer.of("replay_state")[-1]["grasps"][4]
        moment_s = start_s + 0.4
        messages, frames = jump(viewer, position_s=moment_s)
        [identification] = [message for message in messages if message["type"] == "identification"]
        assert (identification["grasp"], identification["in_grasp"], identification["label"]) == (5, True, "bladder")
        assert 0 < 1000 * moment_s - identification["tick"] <= 101
        assert [m["grasp"]["index"] for m in messages if m["type"] == "grasp"] == [1, 2, 3, 4]
        assert messages[0]["server_time_ms"] == pytest.approx(1000 * moment_s)
        assert messages[1]["type"] == "state"
        [(first, end)] = ticks(frames, HISTORY)
        assert (first, end) == (0, round(1000 * moment_s))
        assert not ticks(frames)
        viewer.send(type="replay", playing=True)
        viewer.listen(lambda: len(ticks(viewer.frames)) > 5)
        assert ticks(viewer.frames)[0][0] == end
        assert follow_each_other(ticks(viewer.frames))


def test_a_pause_shows_nothing_new_and_then_it_goes_on_where_it_was(service):
    with watching(service) as viewer:
        viewer.listen(lambda: len(ticks(viewer.frames)) > 5)
        viewer.send(type="replay", playing=False)
        viewer.listen(lambda: not viewer.of("replay_state")[-1]["playing"])
        frames, position_s = len(viewer.frames), viewer.of("replay_state")[-1]["position_s"]
        listen_for(viewer, 0.5)
        assert len(viewer.frames) == frames
        assert viewer.of("replay_state")[-1]["position_s"] == position_s
        viewer.send(type="replay", playing=True, speed=4)
        viewer.listen(lambda: len(ticks(viewer.frames)) > frames + 5)
        assert follow_each_other(ticks(viewer.frames))


def test_at_the_end_it_waits_and_to_play_then_begins_anew(service):
    with watching(service, speed=10, position_s=9.0) as viewer:
        viewer.listen(lambda: at_its_end(viewer))
        listen_for(viewer, 0.3)
        assert at_its_end(viewer)
        frames, greetings = len(viewer.frames), len(viewer.of("hello"))
        viewer.send(type="replay", playing=True)
        viewer.listen(lambda: len(ticks(viewer.frames[frames:])) > 1)
        assert len(viewer.of("hello")) == greetings + 1
        assert ticks(viewer.frames[frames:])[0][0] == 0


def test_two_viewers_of_one_recording_do_not_disturb_each_other(service):
    with watching(service, playing=False, position_s=3.0) as still, watching(service, speed=10) as moving:
        moving.listen(lambda: at_its_end(moving))
        listen_for(still, 0.3)
        state = still.of("replay_state")[-1]
        assert (state["playing"], state["position_s"], state["speed"]) == (False, 3.0, 1.0)
        assert not ticks(still.frames)
        assert moving.of("state")[-1]["viewers"] == 2


def test_a_replay_waits_for_a_viewer_that_does_not_follow(service):
    with watching(service, playing=False) as viewer:
        viewer.send(type="replay", playing=True)
        end = time.monotonic() + 2.0
        viewer.listen(lambda: time.monotonic() > end, answer=False)
        assert 1 < len(viewer.frames) <= SETTINGS.server.chart_window_frames
        assert viewer.of("replay_state")[-1]["position_s"] < 1.5
        viewer.send(type="received", sequence=viewer.frames[-1][0][5])
        frames = len(viewer.frames)
        viewer.listen(lambda: len(viewer.frames) > frames + 5)
        assert follow_each_other(ticks(viewer.frames))


def test_a_broken_recording_says_so_with_its_line(service):
    def read():
        recordings = {r["name"]: r for r in service.http.get("/api/recordings").json()["recordings"]}
        return recordings[NAME]["duration_s"] and recordings["broken.lvm"]["problem"] and recordings

    recordings = until(read)
    assert recordings[NAME]["duration_s"] == pytest.approx(0.5 + 1.25 * CYCLES, abs=0.01)
    says = "broken.lvm, line 1001: expected 6 columns, found 2"
    assert recordings["broken.lvm"]["problem"].startswith(says)
    with connect(f"ws://127.0.0.1:{service.port}/api/recordings/broken.lvm/replay") as connection:
        message, code, reason = closed(connection)
    assert (message["type"], code) == ("event", 1008)
    assert message["text"].startswith(says)
    assert reason.startswith(says)


@pytest.mark.parametrize("name", ["nope.lvm", "../x", "..%2Fx", "..%2F..%2Fetc%2Fpasswd", "..", "%2Fetc%2Fpasswd"])
def test_what_is_not_on_the_shelf_is_not_found(service, name):
    response = service.http.get(f"/api/recordings/{name}/file")
    assert response.status_code == 404
    assert response.headers["content-type"] == "application/problem+json"


def test_a_replay_of_what_is_not_on_the_shelf_says_so(service):
    with connect(f"ws://127.0.0.1:{service.port}/api/recordings/nope.lvm/replay") as connection:
        message, code, _ = closed(connection)
    assert (message["type"], code) == ("event", 1008)
    assert "There is no recording 'nope.lvm'" in message["text"]


def test_a_recording_can_be_downloaded_whole_and_in_parts(service, path):
    whole = service.http.get(f"/api/recordings/{NAME}/file")
    assert whole.content == path.read_bytes()
    assert whole.headers["content-disposition"] == f'attachment; filename="{NAME}"'
    part = service.http.get(f"/api/recordings/{NAME}/file", headers={"Range": "bytes=100-199"})
    assert (part.status_code, part.content) == (206, path.read_bytes()[100:200])


@pytest.mark.parametrize("where", ["live", f"recordings/{NAME}/replay"])
def test_nonsense_ends_the_connection_and_the_live_tool_obeys_no_replay(service, where):
    message = "nonsense" if "replay" in where else json.dumps({"type": "replay", "playing": False})
    with connect(f"ws://127.0.0.1:{service.port}/api/{where}", max_size=None) as connection:
        connection.send(message)
        with pytest.raises(ConnectionClosed, match="1007"):
            while True:
                connection.recv(timeout=5)


def test_a_run_goes_on_undisturbed_while_a_film_is_made(service):
    write_lvm(service.data / "recordings" / "long.lvm", joined(simulate_raw("liver", cycles=40)))
    with Listener(service) as live:
        run = service.run(protocol="trapezoid_2hz", cycles=3, tissue="bladder")
        with Listener(service, "/api/recordings/long.lvm/replay"):  # which begins to be made
            live.listen(lambda: len(live.of("grasp")) >= 3, 60.0)
    assert service.finished(run["id"])["state"] == "finished"
    labels = [grasp["label"] for grasp in service.http.get(f"/api/runs/{run['id']}/grasps").json()]
    assert labels == ["bladder"] * 3
    assert follow_each_other(ticks(live.frames))
    assert "graspwatch_lost_samples_total 0.0" in service.http.get("/metrics").text


def test_a_film_whose_process_dies_is_told_and_can_be_asked_for_again(service):
    shutil.copy(service.data / "recordings" / NAME, service.data / "recordings" / "another.lvm.gz")
    with connect(f"ws://127.0.0.1:{service.port}/api/recordings/another.lvm.gz/replay") as connection:
        os.kill(service.worker("film"), signal.SIGKILL)
        message, code, _ = closed(connection)
    assert (message["type"], code) == ("event", 1008)
    assert "died (signal 9)" in message["text"]
    with watching(service, "another.lvm.gz", speed=10) as viewer:
        viewer.listen(lambda: at_its_end(viewer))
    assert not list(service.data.glob(".film-*"))


@pytest.mark.long
def test_a_film_that_nobody_waits_for_is_given_up(service):
    shutil.copy(service.data / "recordings" / NAME, service.data / "recordings" / "third.lvm.gz")
    with connect(f"ws://127.0.0.1:{service.port}/api/recordings/third.lvm.gz/replay"):
        film = service.worker("film")
    until(lambda: not os.path.exists(f"/proc/{film}"))
    until(lambda: not list(service.data.glob(".film-*")))


def test_recordings_named_on_the_command_line_are_served_without_a_tool(tmp_path):
    path = write_lvm(tmp_path / "short.lvm", joined(simulate_raw("gallbladder", cycles=2)))
    few = (CONFIG_DIR / "graspwatch.toml").read_text().replace("max_viewers = 100", "max_viewers = 1")
    (tmp_path / "few.toml").write_text(few)
    asked = "--serve", "--tool", "nidaq", "--config", str(tmp_path / "few.toml")
    with Service("replay", str(path), *asked) as running:
        assert running.http.get("/api/health").json()["detail"] == "replay"
        assert running.printed_address.endswith("/recordings/short.lvm")  # the page of this recording's replay
        assert "<title>Graspwatch</title>" in running.http.get("/recordings/short.lvm").text
        stopped = running.http.post("/api/stop")
        assert (stopped.status_code, stopped.json()["stopped"]) == (200, False)
        assert running.http.post("/api/runs", json={"protocol": "sine"}).status_code == 409
        assert [r["name"] for r in running.http.get("/api/recordings").json()["recordings"]] == ["short.lvm"]
        with watching(running, "short.lvm", speed=10) as viewer:
            viewer.listen(lambda: at_its_end(viewer))
            assert [message["grasp"]["label"] for message in viewer.of("grasp")] == ["gallbladder"] * 2
            with connect(f"ws://127.0.0.1:{running.port}/api/recordings/short.lvm/replay") as another:
                assert closed(another)[1] == 1013
        with connect(f"ws://127.0.0.1:{running.port}/api/recordings/short.lvm/replay", max_size=None):
            assert running.end() in (0, -signal.SIGTERM, 128 + signal.SIGTERM)
        assert "Traceback" not in running.process.stderr.read()


@pytest.mark.long
@pytest.mark.recordings
def test_a_recording_of_the_real_tool_plays_to_its_end(recordings):
    path = next(path for path in recordings if path.name.startswith("liver4Hz1"))
    with Service("replay", str(path), "--serve") as running, watching(running, path.name, speed=10) as viewer:
        viewer.listen(lambda: at_its_end(viewer))
        report = replay_recording(RecordingSource(path, RIG), RecordingContext(RIG, LIBRARY, SETTINGS), lambda _: None)
        assert [message["grasp"]["label"] for message in viewer.of("grasp")] == [g.label for g in report.grasps]
        assert ticks(viewer.frames)[-1][1] == report.samples
        assert follow_each_other(ticks(viewer.frames))
