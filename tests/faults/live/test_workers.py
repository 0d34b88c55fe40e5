"""Workers that die, hang, fail or take all memory, in the midst of a grasp on a board that outlives them."""

import os
import signal
import time

import numpy as np
import pytest
from boards import ServedBoard
from sabotage import SABOTEUR, SIGNALS
from service import Listener, Service, until

from acquisition.recordings.mcap_reader import McapFile
from app.recordings.run_reader import read_run
from app.service.workers import display_worker_name
from config.load import load_library

pytestmark = pytest.mark.alone


def long(*values):
    """A case for `make safety`, not for every run of the suite."""
    return pytest.param(*values, marks=pytest.mark.long)


ZERO_MS, ALARM_S = 100.0, 0.5
LONG = {"protocol": "trapezoid_025hz", "cycles": 20}
STRONG = {"protocol": "strong_2hz", "cycles": 40}
"""Without the limiter over the injury threshold of what is held, which is the lowest of the library."""
LOWEST_N = load_library("porcine").lowest_threshold_n


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    with ServedBoard(tmp_path_factory.mktemp("board")) as served:
        yield served


@pytest.fixture
def service(board, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(SABOTEUR))
    with Service("serve", "--tool", str(board.tool_file)) as running:
        yield running


def start(service, board, what=LONG):
    run = service.run(**what)
    board.wait_for_force()
    time.sleep(0.2)
    return run


@pytest.mark.parametrize("how", ["kill -9", *(long(how) for how in ("hangs", "exception", "memory hog"))])
def test_an_acquisition_that_is_lost_leaves_the_motor_at_zero_within_100_ms(service, board, how, reactions):
    with Listener(service) as listener:
        run = start(service, board)
        pid = service.worker("acquisition")
        struck_ns = time.monotonic_ns()
        os.kill(pid, SIGNALS[how])
        took_ms = board.zero_after_ms(struck_ns)
        reactions.add(f"acquisition: {how}", "hold", took_ms, ZERO_MS)
        told_s = listener.listen(lambda: any(a["priority"] == "high" for a in listener.of("alarm")))
        reactions.add(f"acquisition: {how}: alarm", "hold", told_s * 1e3, ALARM_S * 1e3)
    assert took_ms <= ZERO_MS
    assert told_s <= ALARM_S
    assert service.finished(run["id"])["state"] == "failed"
    until(lambda: not os.path.exists(f"/proc/{pid}") and service.ready())
    assert board.output_v == 0.0
    assert service.http.post("/api/runs", json=LONG).status_code == 409
    service.acknowledge_fault()
    start(service, board)  # it grasps again
    service.http.post("/api/stop")
    assert board.output_v == 0.0


@pytest.mark.parametrize(
    ("worker", "how"),
    [
        ("estimator", "kill -9"),
        *(long("estimator", how) for how in ("hangs", "exception", "memory hog")),
        *(long("recorder", how) for how in SIGNALS),
        *(long("guard", how) for how in SIGNALS),
    ],
)
def test_any_other_worker_that_is_lost_is_told_and_the_grasp_goes_on(service, board, worker, how, reactions):
    with Listener(service) as listener:
        run = start(service, board, STRONG)
        began = time.monotonic()
        pid = service.worker(worker)
        os.kill(pid, SIGNALS[how])
        texts = (display_worker_name(worker), "estimates")
        told_s = listener.listen(lambda: any(text in a["text"] for a in listener.of("alarm") for text in texts))
        reactions.add(f"{worker}: {how}: alarm", "hold", told_s * 1e3, ALARM_S * 1e3)
        assert told_s <= ALARM_S
    board.wait_for_force()
    until(lambda: service.worker(worker) != pid and service.conditions()[worker] == "running")
    board.wait_for_force()  # the next grasp
    assert service.http.get(f"/api/runs/{run['id']}").json()["state"] == "running"
    ran_s = time.monotonic() - began
    service.http.post("/api/stop")
    assert board.output_v == 0.0
    assert board.peak_force_n < LOWEST_N
    assert "graspwatch_lost_samples_total 0.0" in service.http.get("/metrics").text
    first, *more = until(lambda: whole_files(service, run["id"]))
    assert bool(more) is (worker == "recorder")
    ticks = first.samples["tick"]
    assert (np.diff(ticks) == 1).all()
    if worker != "recorder":
        assert ticks[-1] - ticks[0] > (ran_s + 0.2) * 1000  # to the end, and from before the run


@pytest.mark.long
@pytest.mark.parametrize("how", ["hangs", "exception", "memory hog"])
@pytest.mark.parametrize("worker", ["estimator", "recorder"])
def test_a_worker_that_is_lost_while_it_starts_is_replaced(service, worker, how):
    """Signals before its first message: it hangs for ever, or takes memory before its bound for work is set."""
    before = service.worker(worker)
    os.kill(before, signal.SIGKILL)
    starting = until(lambda: (pid := service.worker(worker)) != before and pid)
    os.kill(starting, SIGNALS[how])
    until(lambda: service.ready() and set(service.conditions().values()) == {"running"}, 60.0)
    assert how != "hangs" or not os.path.exists(f"/proc/{starting}")  # a library may swallow what is raised in it


def whole_files(service, run_id):
    """What the recordings of a run hold, once all are closed; the first of a recorder that died ends with it."""
    paths = sorted((service.data / "recordings").glob(f"{run_id}*.mcap"))
    complete = paths and all(McapFile(path).complete for path in paths)
    return [read_run(path) for path in paths] if complete else None
