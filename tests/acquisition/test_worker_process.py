"""Real-time priority: taken, lowered while a process computes without a pause, taken again, not given to children."""

import hashlib
import multiprocessing
import os
import signal
import time
from multiprocessing.connection import Connection

import numpy as np
import pytest

from acquisition.worker_process import (
    RealtimePriority,
    read_process_snapshot,
    start_child_process,
    take_server_priority,
)


def may_take_priority() -> bool:
    """Tried in a process of its own: this one keeps its own priority."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1] == 0
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except PermissionError:
        os._exit(1)
    os._exit(0)


pytestmark = pytest.mark.skipif(not may_take_priority(), reason="the system grants no real-time priority here")


def tell_own(told: Connection) -> None:
    time.sleep(0.1)  # its parent lowers it as soon as it is there
    told.send(os.sched_getscheduler(0))


def run_wild(told: Connection) -> None:
    priority = take_server_priority(requested=True)
    told.send(os.sched_getscheduler(0))
    child = start_child_process("child", tell_own, told)
    child.join()
    end_s = time.monotonic() + 10.0
    while os.sched_getscheduler(0) == os.SCHED_FIFO and time.monotonic() < end_s:
        pass
    told.send(os.sched_getscheduler(0))
    priority.renew()
    told.send(os.sched_getscheduler(0))


def test_priority_is_lost_by_computing_without_end_and_comes_back() -> None:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=run_wild, args=(theirs,))
    process.start()
    policies = {name: ours.recv() if ours.poll(20.0) else None for name in ("at first", "a child", "wild", "kept")}
    process.join()
    assert policies == {
        "at first": os.SCHED_FIFO,
        "a child": os.SCHED_OTHER,
        "wild": os.SCHED_OTHER,
        "kept": os.SCHED_FIFO,
    }


def test_it_is_not_taken_unasked() -> None:
    before = os.sched_getscheduler(0)
    assert str(take_server_priority(requested=False)) == "priority not asked for"
    assert os.sched_getscheduler(0) == before


def work_off_a_backlog(told: Connection) -> None:
    priority = RealtimePriority(True, 70, cpu_burst_us=200_000)
    end_s = time.monotonic() + 2.0
    while time.monotonic() < end_s:
        priority.renew()
    told.send((priority.times_lowered, str(priority)))
    time.sleep(0.01)
    priority.renew()
    told.send(os.sched_getscheduler(0))


def test_a_worker_with_a_backlog_is_slowed_down_and_not_ended() -> None:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=work_off_a_backlog, args=(theirs,))
    process.start()
    times, text = ours.recv() if ours.poll(20.0) else (0, "")
    assert times > 1  # for as long as it does not wait for anything
    assert text == f"priority granted, lowered {times} times"
    assert ours.recv() == os.SCHED_FIFO
    process.join()
    assert process.exitcode == 0


def never_return_from_a_library() -> None:
    RealtimePriority(True, 10, cpu_burst_us=200_000, hard_limit_s=1)
    hashlib.pbkdf2_hmac("sha512", b"", b"", 10**9)


def test_a_library_that_never_returns_is_ended_in_the_last_resort() -> None:
    process = multiprocessing.get_context("spawn").Process(target=never_return_from_a_library)
    process.start()
    process.join(30.0)
    assert process.exitcode == -signal.SIGKILL


def test_a_stopped_process_is_seen_to_be_held_up() -> None:
    process = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60.0,))
    process.start()
    try:
        os.kill(process.pid, signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOWAIT)
        assert read_process_snapshot(process.pid).is_suspended
        os.kill(process.pid, signal.SIGCONT)
        os.waitid(os.P_PID, process.pid, os.WCONTINUED | os.WNOWAIT)
        assert not read_process_snapshot(process.pid).is_suspended
    finally:
        process.kill()
        process.join()


def send_sum(told: Connection, numbers: np.ndarray) -> None:
    time.sleep(0.5)
    told.send(float(numbers.sum()))


def test_a_process_with_many_arguments_is_started_without_waiting_for_it() -> None:
    ours, theirs = multiprocessing.Pipe(duplex=False)
    begin = time.monotonic()
    child = start_child_process("child", send_sum, theirs, np.ones(10_000_000))
    took_s = time.monotonic() - begin
    theirs.close()
    assert ours.recv() == 10_000_000.0
    assert took_s < time.monotonic() - begin - 0.5  # it neither waited for the work nor for the import of numpy
    child.join()


def test_a_parent_learns_that_its_process_with_many_arguments_was_killed_while_it_loaded() -> None:
    """The parent waited for ever; a service would neither answer nor end."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    child = start_child_process("child", send_sum, theirs, np.ones(10_000_000))
    child.kill()
    theirs.close()
    with pytest.raises(EOFError):
        ours.recv()
    child.join()
    assert child.exitcode == -signal.SIGKILL
