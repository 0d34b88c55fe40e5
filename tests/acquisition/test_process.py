"""The priority of what serves people: taken, given up when it runs wild, taken again, and not handed on to children."""

import multiprocessing
import os
import time
from multiprocessing.connection import Connection

import pytest

from acquisition.process import ServingPriority, start_child


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
    priority = ServingPriority(wanted=True)
    told.send(os.sched_getscheduler(0))
    child = multiprocessing.get_context("spawn").Process(target=tell_own, args=(told,))
    start_child(child)
    child.join()
    end_s = time.monotonic() + 10.0
    while os.sched_getscheduler(0) == os.SCHED_FIFO and time.monotonic() < end_s:
        pass
    told.send(os.sched_getscheduler(0))
    priority.keep()
    told.send(os.sched_getscheduler(0))


def test_priority_is_lost_by_computing_without_end_and_comes_back() -> None:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=run_wild, args=(theirs,))
    process.start()
    policies = {name: ours.recv() if ours.poll(20.0) else None for name in ("at first", "a child", "wild", "kept")}
    process.join()
    assert policies == {
        "at first": os.SCHED_FIFO, "a child": os.SCHED_OTHER, "wild": os.SCHED_OTHER, "kept": os.SCHED_FIFO,
    }  # fmt: skip


def test_it_is_not_taken_unasked() -> None:
    before = os.sched_getscheduler(0)
    assert str(ServingPriority(wanted=False)) == "priority not asked for"
    assert os.sched_getscheduler(0) == before
