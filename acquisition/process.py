"""What every worker process does alike: die with its parent, end in order on a signal, tell its priority."""

import contextlib
import ctypes
import gc
import os
import resource
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import FrameType

from config.schema import Realtime

PR_SET_PDEATHSIG = 1
PR_SET_NAME = 15
MCL_CURRENT, MCL_FUTURE = 1, 2
MORE_MEMORY_BYTES = 512 << 20
"""Than a worker has once it is ready: one that wants more ends, and not the machine's others with it."""
MOST_AT_A_STRETCH_US = 300_000
"""Of a core, at real-time priority, without waiting for anything: a block takes 400, those of a second 80,000."""
SERVING_PRIORITY = 10
"""Of the server, through which STOP passes, and of the recorder: below all that reads, estimates or guards."""
SERVING_STRETCH_US = 1_000_000
GRANTED_WORDS = {True: "granted", False: "refused", None: "not asked for"}


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
    status = Path("/proc/self/status").read_text()
    now_kb = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmData:"))
    bound = now_kb * 1024 + MORE_MEMORY_BYTES
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (bound if most == resource.RLIM_INFINITY else min(bound, most), most))


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
    return _grants(priority)


def _grants(priority: int) -> bool:
    try:
        _schedule(os.SCHED_FIFO, priority)
    except PermissionError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class Granted:
    """What the system gave a worker of what its settings ask for; None: not asked for."""

    priority: bool | None
    memory: bool | None
    core: int | None
    garbage: bool

    def __str__(self) -> str:
        core = "any core" if self.core is None else f"core {self.core}" if self.core >= 0 else "its core refused"
        garbage = "frozen" if self.garbage else "collected"
        priority, memory = GRANTED_WORDS[self.priority], GRANTED_WORDS[self.memory]
        return f"priority {priority}, memory lock {memory}, {core}, garbage {garbage}"


def take_realtime(wanted: Realtime, priority: int, place: int, stretch_us: int = MOST_AT_A_STRETCH_US) -> Granted:
    """Bound its memory and ask for what the settings want, once everything is ready; `place` chooses of the cores."""
    bound_memory()
    if wanted.freeze_garbage:
        calm_garbage_collector()
    return Granted(
        priority=ask_for_realtime(priority, stretch_us) if wanted.priority else None,
        memory=_lock_memory() if wanted.lock_memory else None,
        core=_stay_on(wanted.cores[place % len(wanted.cores)]) if wanted.cores else None,
        garbage=wanted.freeze_garbage,
    )


class ServingPriority:
    """Real-time priority for what serves people and disks: before other programs, whatever session they belong to.

    Between sessions Linux shares each core evenly, however little one of them asks for (autogroups, sched(7)): beside a
    busy browser a server waited 0.5 s for its turn. Unlike a worker's, a thread that computes for a second at a stretch
    is not ended: the whole process falls back to the usual priority, until `keep` is called.
    """

    def __init__(self, wanted: bool) -> None:
        """In the main thread. Takes it at once where it is wanted and the system grants it."""
        self.granted: bool | None = None
        if wanted:
            signal.signal(signal.SIGXCPU, self._fall_back)
            self.granted = self._take()

    def __str__(self) -> str:
        return f"priority {GRANTED_WORDS[self.granted]}"

    def keep(self) -> None:
        """Once a second: whoever comes here does not compute without end."""
        if self.granted:
            self._take()

    def _take(self) -> bool:
        _, most = resource.getrlimit(resource.RLIMIT_RTTIME)
        stretch_us = SERVING_STRETCH_US if most == resource.RLIM_INFINITY else min(SERVING_STRETCH_US, most)
        resource.setrlimit(resource.RLIMIT_RTTIME, (stretch_us, most))
        return _grants(SERVING_PRIORITY)

    def _fall_back(self, number: int, frame: FrameType | None) -> None:
        _schedule(os.SCHED_OTHER, 0)


def start_child(process: BaseProcess) -> None:
    """At the usual priority, but not before it is there: until it is loaded, its parent waits with it for its turn."""
    process.start()
    os.sched_setscheduler(process.pid, os.SCHED_OTHER, os.sched_param(0))


def _lock_memory() -> bool:
    """Only where no bound on locked memory would refuse what is asked for later."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != resource.RLIM_INFINITY and os.geteuid() != 0:
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    return libc.mlockall(MCL_CURRENT | MCL_FUTURE) == 0


def _stay_on(core: int) -> int:
    """The core, or -1 where this process may not run on it."""
    try:
        _for_each_thread(lambda thread: os.sched_setaffinity(thread, {core}))
    except OSError:  # there is no such core, or not for this process
        return -1
    return core


@contextlib.contextmanager
def at_realtime(priority: int) -> Iterator[None]:
    """Meanwhile only, for a program that does other things as well."""
    ask_for_realtime(priority)
    try:
        yield
    finally:
        _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> None:
    _for_each_thread(lambda thread: os.sched_setscheduler(thread, policy, os.sched_param(priority)))


def _for_each_thread(do: Callable[[int], None]) -> None:
    """Of this process, those of libraries included."""
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            do(int(thread))
