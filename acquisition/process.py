"""What every worker process does alike: die with its parent, end in order on a signal, tell its priority."""

import contextlib
import ctypes
import gc
import os
import resource
import signal
from collections.abc import Iterator
from types import FrameType

PR_SET_PDEATHSIG = 1
PR_SET_NAME = 15
MOST_MEMORY_BYTES = 2 << 30
"""Of one worker, four times what the largest takes: one that wants more ends, and not the machine's others with it."""
MOST_AT_A_STRETCH_US = 300_000
"""Of a core, at real-time priority, without waiting for anything: a block takes 400, those of a second 80,000."""


class StopFlag:
    """Set by SIGTERM and SIGINT; a worker looks at it once a turn, so that it ends with the motor at zero."""

    def __init__(self) -> None:
        self.set = False
        signal.signal(signal.SIGTERM, self._on_signal)
        signal.signal(signal.SIGINT, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.set = True


def become_worker(name: str, parent_pid: int) -> StopFlag:
    """Tie this process to its parent, make it answer signals, and let `ps` and `top` show its name."""
    flag = StopFlag()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    libc.prctl(PR_SET_NAME, name.encode())
    if os.getppid() != parent_pid:  # the parent died before the line above
        flag.set = True
    return flag


def bound_memory() -> None:
    """From here on more memory than any worker needs is refused to this process."""
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    least = MOST_MEMORY_BYTES if most == resource.RLIM_INFINITY else min(MOST_MEMORY_BYTES, most)
    resource.setrlimit(resource.RLIMIT_DATA, (least, most))


def calm_garbage_collector() -> None:
    """A full collection took 31 ms: freeze what start-up made, collect only by reference counts from here on."""
    gc.collect()
    gc.freeze()
    gc.disable()


def ask_for_realtime(priority: int, stretch_us: int = MOST_AT_A_STRETCH_US) -> bool:
    """SCHED_FIFO for every thread, those of ZeroMQ included, if the system grants it; says whether it did.

    A thread that then runs wild would take a whole core from everybody; after `stretch_us` the system ends it instead.
    """
    resource.setrlimit(resource.RLIMIT_RTTIME, (stretch_us, stretch_us))
    try:
        _schedule(os.SCHED_FIFO, priority)
    except PermissionError:
        return False
    return True


@contextlib.contextmanager
def at_realtime(priority: int) -> Iterator[None]:
    """Meanwhile only, for a program that does other things as well."""
    ask_for_realtime(priority)
    try:
        yield
    finally:
        _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> None:
    """Every thread of this process."""
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            os.sched_setscheduler(int(thread), policy, os.sched_param(priority))
