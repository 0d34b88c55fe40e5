"""A machine whose clock is set, or one of whose cores is taken."""

import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest
from service import Service, until

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
        busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
        try:
            os.sched_setaffinity(busy.pid, {max(os.sched_getaffinity(0))})
            run = running.run(protocol="trapezoid_2hz", cycles=4, tissue="bladder")
            assert running.finished(run["id"])["state"] == "finished"
        finally:
            busy.kill()
            busy.wait()
        assert "graspwatch_lost_samples_total 0.0" in running.http.get("/metrics").text
