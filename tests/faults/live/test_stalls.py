"""Workers that are held up for a while, as on a machine that is paused or swaps: they catch up, and none is ended."""

import os
import signal
import time
from contextlib import contextmanager
from itertools import product

import pytest
from boards import ServedBoard
from service import Listener, Service, until

from acquisition.bench.jitter import keep_cores_busy
from app.service.workers import display_worker_name

pytestmark = pytest.mark.alone

LONG = {"protocol": "trapezoid_025hz", "cycles": 40}
WORKERS = ("acquisition", "estimator", "recorder", "guard")
BOARD_KEEPS_S = 10  # of samples that nobody reads
ALARM_S = 0.5


def lasting(*shown, long):
    return [*shown, *(pytest.param(*each, marks=pytest.mark.long) for each in long)]


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    with ServedBoard(tmp_path_factory.mktemp("board")) as served:
        yield served


@pytest.fixture(scope="module")
def service(board):
    with Service("serve", "--tool", str(board.tool_file)) as running:
        yield running


@contextmanager
def stopped(pid, seconds):
    """Meanwhile, and for that long at least."""
    begin_s = time.monotonic()
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
        time.sleep(max(seconds - (time.monotonic() - begin_s), 0.0))
    finally:
        os.kill(pid, signal.SIGCONT)


def pids_of(service):
    return {name: service.worker(name) for name in WORKERS}


def lost_samples(service):
    lines = service.http.get("/metrics").text.splitlines()
    return float(next(line for line in lines if line.startswith("graspwatch_lost_samples_total")).split()[1])


def is_well(service):
    """No alarm is on but a fault that is latched and samples that were lost or late a while ago."""
    on = [alarm["id"] for alarm in service.http.get("/api/alarms").json()]
    running = set(service.conditions().values()) == {"running"}
    return running and not [each for each in on if not each.startswith(("fault-", "let-go", "lost", "late"))]


@pytest.mark.parametrize(
    ("worker", "stalled_s", "busy"),
    lasting(
        *((worker, 3, False) for worker in WORKERS[1:]),
        long=[*product(WORKERS[1:], (10, 30), (False,)), *product(WORKERS[1:], (3, 10, 30), (True,))],
    ),
)
def test_a_run_goes_on_while_another_worker_is_held_up_and_nothing_is_lost(
    service, board, worker, stalled_s, busy, reactions
):
    pids, before = pids_of(service), lost_samples(service)
    with keep_cores_busy(busy):
        run = service.run(**LONG)
        board.wait_for_force()
        with Listener(service) as listener, stopped(pids[worker], stalled_s):
            texts = (display_worker_name(worker), "estimates")
            told_s = listener.listen(lambda: any(text in a["text"] for a in listener.of("alarm") for text in texts))
        reactions.add(f"{worker}: held up: alarm", "hold", told_s * 1e3, ALARM_S * 1e3)
        until(lambda: is_well(service))
        assert pids_of(service) == pids
        board.wait_for_force()
        assert service.http.get(f"/api/runs/{run['id']}").json()["state"] == "running"
    assert lost_samples(service) == before
    service.http.post("/api/stop")
    assert board.output_v == 0.0
    assert busy or told_s <= ALARM_S
    metrics = service.http.get("/metrics").text
    assert 'graspwatch_missing_blocks{receiver="estimator"} 0.0' in metrics


@pytest.mark.parametrize(
    ("stalled_s", "busy"), lasting((3, False), long=[(3, True), *product((10, 30), (False, True))])
)
def test_a_run_whose_acquisition_was_held_up_has_failed_with_the_motor_at_zero(service, board, stalled_s, busy):
    pids = pids_of(service)
    with keep_cores_busy(busy):
        run = service.run(**LONG)
        board.wait_for_force()
        with stopped(pids["acquisition"], stalled_s):
            until(lambda: board.output_v == 0.0, 1.0)  # by the guard
        over = service.finished(run["id"])
        assert board.output_v == 0.0
        until(lambda: is_well(service))
        assert pids_of(service) == pids
    assert over["state"] == "failed"
    assert "held up" in service.acknowledge_fault()
    service.run(**LONG)
    board.wait_for_force()
    service.http.post("/api/stop")
    assert board.output_v == 0.0


@pytest.mark.parametrize("stalled_s", lasting(3, long=[(30,)]))
def test_samples_that_the_board_kept_are_read_late_and_the_others_are_counted(service, board, stalled_s):
    pids, before = pids_of(service), lost_samples(service)
    with stopped(pids["acquisition"], stalled_s):
        pass
    overflowed = stalled_s > BOARD_KEEPS_S
    until(lambda: is_well(service) and (lost_samples(service) > before) == overflowed)
    assert pids_of(service) == pids
    lost = lost_samples(service) - before
    most = 1000 * (stalled_s + 1) if overflowed else 0
    assert (1000 * stalled_s if overflowed else 0) <= lost <= most
