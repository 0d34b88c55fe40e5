"""A machine whose clock is set, or one of whose cores is taken."""

import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest
from service import Service, until

LIBFAKETIME = next(iter(Path("/usr/lib").glob("*/faketime/libfaketime.so.1")), None)


@pytest.mark.skipif(LIBFAKETIME is None, reason="needs libfaketime (Debian: apt install faketime)")
@pytest.mark.parametrize("step_h", [1, -1])
def test_a_wall_clock_that_is_set_in_a_run_disturbs_nothing(step_h, tmp_path, monkeypatch):
    offset = tmp_path / "offset"
    offset.write_text("+0")
    for name, value in {
        "LD_PRELOAD": str(LIBFAKETIME), "FAKETIME_TIMESTAMP_FILE": str(offset), "FAKETIME_NO_CACHE": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1", "DONT_FAKE_MONOTONIC": "1",
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    with Service("serve") as running:
        run = running.run(protocol="trapezoid_2hz", cycles=4, tissue="bladder")
        until(lambda: running.http.get(f"/api/runs/{run['id']}").json()["grasps"] >= 1)
        offset.write_text(f"{3600 * step_h:+d}")
        over = running.finished(run["id"])
        assert over["state"] == "finished"
        moved_s = (datetime.fromisoformat(over["ended_at"]) - datetime.now(UTC)).total_seconds()
        assert abs(moved_s - 3600 * step_h) < 60  # it was set indeed
        labels = {grasp["label"] for grasp in running.http.get(f"/api/runs/{run['id']}/grasps").json()}
        assert labels <= {"bladder", "undecided"}
        assert not running.http.get("/api/alarms").json()
        assert "graspwatch_lost_samples_total 0.0" in running.http.get("/metrics").text
        assert running.run(protocol="trapezoid_4hz", cycles=1)


def test_a_core_that_another_program_takes_costs_no_sample():
    with Service("serve") as running:
        busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
        try:
            os.sched_setaffinity(busy.pid, {max(os.sched_getaffinity(0))})
            run = running.run(protocol="trapezoid_2hz", cycles=4, tissue="bladder")
            assert running.finished(run["id"])["state"] == "finished"
        finally:
            busy.kill()
            busy.wait()
        assert "graspwatch_lost_samples_total 0.0" in running.http.get("/metrics").text
