"""A machine whose clock is set, one of whose cores is taken, or whose disk is full."""

import contextlib
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest
from service import Listener, Service, until

from app.recordings.run_reader import read_run
from config.load import CONFIG_DIR

pytestmark = pytest.mark.alone

WRONG_CLOCK = Path(__file__).with_name("wrong_clock")


@pytest.mark.long
@pytest.mark.parametrize("step_h", [1, -1])
def test_a_wall_clock_that_is_set_in_a_run_disturbs_nothing(step_h, tmp_path, monkeypatch):
    offset = tmp_path / "offset"
    offset.write_text("0")
    monkeypatch.setenv("PYTHONPATH", str(WRONG_CLOCK))
    monkeypatch.setenv("WRONG_CLOCK", str(offset))
    with Service("serve") as running:
        run = running.run(protocol="trapezoid_2hz", cycles=4, tissue="bladder")
        until(lambda: running.http.get(f"/api/runs/{run['id']}").json()["grasps"] >= 1)
        offset.write_text(str(step_h))
        over = running.finished(run["id"])
        assert over["state"] == "finished"
        moved_s = (datetime.fromisoformat(over["ended_at"]) - datetime.now(UTC)).total_seconds()
        assert abs(moved_s - 3600 * step_h) < 60  # it was set indeed
        labels = {grasp["label"] for grasp in running.http.get(f"/api/runs/{run['id']}/grasps").json()}
        assert labels <= {"bladder", "undecided"}
        assert not running.http.get("/api/alarms").json()
        assert "graspwatch_lost_samples_total 0.0" in running.http.get("/metrics").text
        assert running.run(protocol="trapezoid_4hz", cycles=1)


@pytest.mark.long
def test_a_core_that_another_program_takes_costs_no_sample():
    with Service("serve") as running:
        busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
        try:
            os.sched_setaffinity(busy[0].pid, {max(os.sched_getaffinity(0))})
            for _ in range(2):
                run = running.run(protocol="trapezoid_2hz", cycles=2, tissue="bladder")
                assert running.finished(run["id"])["state"] == "finished"
        finally:
            for program in busy:
                program.kill()
                program.wait()
        assert "graspwatch_lost_samples_total 0.0" in running.http.get("/metrics").text
        told = running.http.get("/api/alarms/history").json()
        assert not [alarm["text"] for alarm in told if alarm["kind"] == "technical"]


@pytest.mark.long
def test_a_disk_that_is_full_ends_the_recording_and_not_the_run(tmp_path):
    """A file system of 300 MB that only the service sees, filled to its last byte in the midst of a run."""
    data, settings = tmp_path / "disk", tmp_path / "little.toml"
    data.mkdir()
    own_disk = (
        "unshare",
        "--user",
        "--map-root-user",
        "--mount",
        "sh",
        "-c",
        f'mount -t tmpfs -o size=300m tmpfs {data} && exec "$@"',
        "sh",
    )
    if subprocess.run([*own_disk, "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("this system lets nobody mount a file system of his own")
    shipped = (CONFIG_DIR / "graspwatch.toml").read_text()
    assert "least_free_bytes = 200_000_000" in shipped
    settings.write_text(shipped.replace("least_free_bytes = 200_000_000", "least_free_bytes = 0"))
    serve = Service("serve", "--config", str(settings), data=data, within=own_disk)
    with serve as running, Listener(running) as viewer:
        seen = Path(f"/proc/{running.process.pid}/root{data}")
        run = running.run(protocol="trapezoid_2hz", cycles=8, tissue="bladder")
        until(lambda: running.http.get(f"/api/runs/{run['id']}").json()["grasps"] >= 1)
        with contextlib.suppress(OSError), (seen / "filler").open("wb", buffering=0) as filler:
            while filler.write(bytes(65_536)):
                pass
        texts = lambda: " ".join(alarm["text"] for alarm in viewer.of("alarm"))  # noqa: E731
        viewer.listen(lambda: "is full: make room" in texts() and "the run goes on" in texts())
        assert running.finished(run["id"])["state"] == "finished"
        assert running.run(protocol="trapezoid_4hz", cycles=1)
        assert running.http.post("/api/stop").status_code == 200
        (seen / "filler").unlink()
        assert len(read_run(seen / f"recordings/{run['id']}.mcap").samples) > 1000
        after = running.run(protocol="trapezoid_4hz", cycles=1)
        running.finished(after["id"])
        whole = seen / f"recordings/{after['id']}.mcap"
        until(lambda: whole.read_bytes().endswith(b"\x89MCAP0\r\n"))
        assert "graspwatch_lost_samples_total 0.0" in running.http.get("/metrics").text
        until(lambda: not running.http.get("/api/alarms").json())
