"""Runs are recorded: all of them, from before their beginning, whatever dies or fills up meanwhile."""

import contextlib
import json
import os
import resource
import signal
import sqlite3
import subprocess
from pathlib import Path

import numpy as np
import pytest
from service import PROGRAM, Listener, Service, until

from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import RecordingSource
from app.analysis.headless import replay_recording
from app.recordings.file_repair import recover_file
from app.recordings.mcap_writer import RecordingContext
from app.recordings.run_reader import read_run
from config.load import load_tool

RIG = load_tool("smart_tool_2013")


@pytest.fixture(scope="module")
def service():
    with Service("serve") as running:
        yield running


def recording_state(service: Service) -> dict:
    with Listener(service) as listener:
        listener.listen(lambda: listener.of("state"))
        return listener.of("state")[-1]["recording"]


def test_a_run_is_recorded_from_before_its_beginning_and_replays_bit_for_bit(service: Service) -> None:
    with Listener(service) as listener:
        listener.listen(lambda: listener.frames and listener.frames[-1][0][6] > 5_500)  # 5 s have gone by
        run = service.run(protocol="trapezoid_2hz", cycles=2, tissue="bladder", by="Ada")
        listener.listen(lambda: any((m["recording"] or {}).get("file") for m in listener.of("state")))
        listener.listen(lambda: len([m for m in listener.of("grasp") if m["run_id"] == run["id"]]) == 2)
        path = service.recorded(run["id"])
        told = [m["grasp"] for m in listener.of("grasp") if m["run_id"] == run["id"]]
    kept = read_run(path)
    ticks, begins = kept.samples["tick"], int(kept.metadata["run_first_tick"])
    assert (np.diff(ticks) == 1).all()
    assert 5_000 <= begins - ticks[0] < 5_020  # whole blocks, which are of 20 samples while nothing moves
    assert (kept.estimates["tick"] == ticks).all()
    assert np.isfinite(kept.estimates["alpha_n"]).any()
    assert [grasp.model_dump(mode="json") for grasp in kept.grasps] == told
    assert (kept.run.state, kept.run.by, kept.run.tissue) == ("finished", "Ada", "bladder")
    recording = RecordingSource(path, RIG)
    comparison = replay_recording(
        recording, RecordingContext.from_recording(recording.mcap_file), lambda _: None
    ).comparison
    assert comparison.compared_samples == ticks[-1] + 1 - begins
    assert comparison.unequal_samples == 0
    listed = {each["name"]: each for each in service.http.get("/api/recordings").json()["recordings"]}
    assert path.name in listed


def test_a_recording_is_verified_by_the_journal_also_if_the_end_of_the_service_completed_it() -> None:
    with Service("serve", "--tissue", "liver") as service:
        first = service.finished(service.run(protocol="trapezoid_4hz", cycles=1)["id"])["id"]
        service.recorded(first)
        second = service.run(protocol="trapezoid_025hz", cycles=5)["id"]
        until(lambda: service.recording_file(second).exists())
        service.end()
        for run_id in (first, second):
            done = subprocess.run(
                [PROGRAM, "verify", run_id, "--data", service.data, "--json"], capture_output=True, text=True
            )
            found = json.loads(done.stdout)
            assert (done.returncode, found["passed"]) == (0, True), done.stderr
            assert {each["outcome"] for each in found["findings"]} == {"passed"}, found
        assert read_run(service.recording_file(second)).run.state == "stopped"  # what the server said last is in it
        path = service.recording_file(first)
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
        done = subprocess.run([PROGRAM, "verify", path], capture_output=True, text=True)
        assert (done.returncode, "the file is not the one that was completed" in " ".join(done.stderr.split())) == (
            3,
            True,
        )


def test_the_second_run_does_not_depend_on_the_first(service: Service) -> None:
    """What is measured in a run begins anew with it: its replay needs nothing that came before."""
    runs = []
    for _ in range(2):
        run = service.run(protocol="trapezoid_2hz", cycles=1, tissue="gallbladder")
        service.finished(run["id"])
        runs.append(service.recorded(run["id"]))
    for path in runs:
        recording = RecordingSource(path, RIG)
        report = replay_recording(recording, RecordingContext.from_recording(recording.mcap_file), lambda _: None)
        assert report.comparison.unequal_samples == 0
        assert report.grasps[-1].index == 1


def test_a_killed_recorder_loses_less_than_a_second_and_the_run_goes_on(service: Service) -> None:
    run = service.run(protocol="trapezoid_2hz", cycles=9, tissue="liver")
    path = service.recording_file(run["id"])
    until(lambda: recording_state(service)["samples"] > 6_500)
    before = recording_state(service)["samples"]
    os.kill(service.worker("recorder"), signal.SIGKILL)
    with Listener(service) as listener:
        listener.listen(lambda: any("recorder" in m["text"] for m in listener.of("alarm")))
    assert service.finished(run["id"])["state"] == "finished"
    parts = until(lambda: len(found := sorted(path.parent.glob(f"{run['id']}*.mcap"))) == 2 and found)
    until(lambda: all(McapFile(part).complete for part in parts))  # the first was made whole by the next recorder
    first, second = read_run(path), read_run(path.with_name(f"{run['id']}-part2.mcap"))
    assert len(first.samples) > before - 1_000
    assert (np.diff(first.samples["tick"]) == 1).all()
    assert second.metadata["continues"] == run["id"]
    assert second.samples["tick"][0] > first.samples["tick"][-1]
    with Listener(service) as listener:
        listener.listen(lambda: listener.of("state"))
        assert not any("recorder" in fault for fault in listener.of("state")[-1]["faults"])


@pytest.mark.long
def test_a_full_disk_ends_the_recording_with_an_alarm_and_not_the_run(service: Service) -> None:
    """The recorder may not write files of more than 1.25 MB: to it that is a full disk."""
    limit = 1_250_000
    recorder = service.worker("recorder")
    resource.prlimit(recorder, resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        with Listener(service) as listener:
            run = service.run(protocol="trapezoid_2hz", cycles=6, tissue="liver")
            alarms = lambda: [m for m in listener.of("alarm") if "the run goes on" in m["text"]]  # noqa: E731
            listener.listen(alarms)
            assert alarms()[0]["priority"] == "medium"
            assert f"{run['id']}.mcap stopped (File too large)" in alarms()[0]["text"]
            assert recording_state(service)["problem"] == alarms()[0]["text"]
            assert service.http.get(f"/api/runs/{run['id']}").json()["state"] == "running"
        assert service.finished(run["id"])["state"] == "finished"
    finally:
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    path = service.recording_file(run["id"])
    assert path.stat().st_size <= limit
    assert len(read_run(path).samples) > 5_500
    assert recover_file(path)
    following = service.run(protocol="trapezoid_2hz", cycles=1, tissue="liver")
    service.finished(following["id"])
    service.recorded(following["id"])
    assert recording_state(service)["problem"] is None


@pytest.mark.long
def test_with_too_little_room_a_run_is_not_recorded_and_says_so(tmp_path: Path) -> None:
    (tmp_path / "little.toml").write_text("[recording]\nleast_free_bytes = 1_000_000_000_000_000\n")
    with Service("serve", "--config", str(tmp_path / "little.toml")) as service, Listener(service) as listener:
        run = service.run(protocol="trapezoid_2hz", cycles=1, tissue="liver")
        said = f"Run {run['id']} is not recorded"
        listener.listen(lambda: any(m["text"].startswith(said) for m in listener.of("alarm")))
        assert service.finished(run["id"])["state"] == "finished"
        assert not service.recording_file(run["id"]).exists()


def indexed(data: Path) -> dict[str, list[tuple]]:
    """Every row of the index, in any order."""
    with contextlib.closing(sqlite3.connect(data / "index.sqlite")) as index:
        return {
            table: sorted(index.execute(f"SELECT * FROM {table}"), key=str)
            for table in ("runs", "grasps", "alarms", "audit", "files")
        }


def test_the_end_of_the_service_makes_the_file_whole_and_the_index_can_be_rebuilt_from_the_files() -> None:
    with Service("serve") as service:
        finished = service.run(protocol="strong_2hz", cycles=1, tissue="liver", by="Ada")
        service.finished(finished["id"])
        run = service.run(protocol="trapezoid_2hz", cycles=20, tissue="liver")
        until(lambda: recording_state(service)["samples"] > 6_000)
        service.end()
        container = McapFile(service.recording_file(run["id"]))
        assert container.complete
        assert len(read_run(container.path).samples) > 6_000
        live = indexed(service.data)
        subprocess.run([PROGRAM, "index", "--rebuild", "--data", service.data], check=True, capture_output=True)
        rebuilt = indexed(service.data)
    assert {table: len(rows) for table, rows in live.items() if table in ("runs", "files")} == {"runs": 2, "files": 2}
    assert live["grasps"]
    rebuilt["audit"] = [row for row in rebuilt["audit"] if "Rebuild the index: done" not in row]
    for table, rows in live.items():
        assert rebuilt[table] == rows, table
