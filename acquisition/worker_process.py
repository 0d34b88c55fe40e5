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

from config.schema import RealtimeSettings

PR_SET_PDEATHSIG = 1
PR_SET_NAME = 15
MCL_CURRENT, MCL_FUTURE = 1, 2
MEMORY_HEADROOM_BYTES = 512 << 20
"""Than a worker has once it is ready: one that wants more ends, and not the machine's others with it."""
WORKER_CPU_BURST_US = 300_000
"""Time a worker may compute at real-time priority without a pause; a block takes 400 us, those of a second 80,000."""
SERVER_PRIORITY = 10
"""Priority of the server, which carries STOP, and of the recorder: below everything that reads, estimates or guards."""
SERVER_CPU_BURST_US = 1_000_000
HARD_CPU_LIMIT_S = 5
"""The kernel ends a worker that computes for so long at real-time priority inside one call of a library."""
GRANT_TEXTS = {True: "granted", False: "refused", None: "not asked for"}


class StopFlag:
    """Set by SIGTERM and SIGINT; a worker looks at it once a turn, so that it ends with the motor at zero."""

    def __init__(self) -> None:
        self.is_set = False
        signal.signal(signal.SIGTERM, self._on_signal)
        signal.signal(signal.SIGINT, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.is_set = True


def initialize_worker(name: str, parent_pid: int) -> StopFlag:
    """Tie this process to its parent, make it answer signals, and let `ps` and `top` show its name."""
    flag = StopFlag()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    libc.prctl(PR_SET_NAME, name.encode())
    if os.getppid() != parent_pid:  # the parent died before the line above
        flag.is_set = True
    return flag


def limit_memory() -> None:
    """From here on more memory than any worker needs is refused to this process."""
    status = Path("/proc/self/status").read_text()
    now_kb = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmData:"))
    bound = now_kb * 1024 + MEMORY_HEADROOM_BYTES
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (bound if most == resource.RLIM_INFINITY else min(bound, most), most))


def freeze_garbage_collector() -> None:
    """A full collection took 31 ms: freeze what start-up made, collect only by reference counts from here on."""
    gc.collect()
    gc.freeze()
    gc.disable()


class RealtimePriority:
    """Real-time priority (SCHED_FIFO) of every thread of this process, lowered while it computes without a pause.

    A real-time thread that computes without end takes a core from all other programs. After `stretch_us` of it the
    kernel signals SIGXCPU, and the process falls back to the usual priority instead of being ended: it may have a
    backlog to work through. `renew` takes the priority again; the kernel grants it for good once the process has
    waited for something.
    """

    def __init__(
        self, requested: bool, priority: int, cpu_burst_us: int, hard_limit_s: int | None = HARD_CPU_LIMIT_S
    ) -> None:
        """Take the priority at once if it is wanted and the system grants it. Call in the main thread.

        After `last_resort_s` at a stretch, inside a single call that never returns to Python, the kernel ends the
        process (SIGKILL); None: never.
        """
        self._priority, self._cpu_burst_us = priority, cpu_burst_us
        self._hard_limit_us = resource.RLIM_INFINITY if hard_limit_s is None else hard_limit_s * 1_000_000
        self.granted: bool | None = None
        self.times_lowered, self._is_lowered = 0, False
        if requested:
            signal.signal(signal.SIGXCPU, self._on_cpu_limit)
            self.granted = self._raise_priority()

    def __str__(self) -> str:
        lowered = f", lowered {self.times_lowered} times" if self.times_lowered else ""
        return f"priority {GRANT_TEXTS[self.granted]}{lowered}"

    def renew(self) -> None:
        """Take the priority again if it was lowered. Call about once a second from the process's main loop."""
        if self._is_lowered:
            self._is_lowered = False
            self._raise_priority()

    def restore_default(self) -> None:
        """Return to the usual priority."""
        if self.granted:
            _set_scheduler(os.SCHED_OTHER, 0)

    def _raise_priority(self) -> bool:
        _, most = resource.getrlimit(resource.RLIMIT_RTTIME)
        most = self._hard_limit_us if most == resource.RLIM_INFINITY else most  # a lower bound of the system's stays
        soft = self._cpu_burst_us if most == resource.RLIM_INFINITY else min(self._cpu_burst_us, most)
        resource.setrlimit(resource.RLIMIT_RTTIME, (soft, most))
        try:
            _set_scheduler(os.SCHED_FIFO, self._priority)
        except PermissionError:
            return False
        return True

    def _on_cpu_limit(self, number: int, frame: FrameType | None) -> None:
        self.times_lowered, self._is_lowered = self.times_lowered + 1, True
        _set_scheduler(os.SCHED_OTHER, 0)


@dataclass(frozen=True, slots=True)
class RealtimeGrant:
    """What the system granted a worker of `[realtime]`; None: not asked for."""

    priority: RealtimePriority
    memory_locked: bool | None
    core: int | None
    garbage_collector_frozen: bool

    def __str__(self) -> str:
        core = "any core" if self.core is None else f"core {self.core}" if self.core >= 0 else "its core refused"
        garbage = "frozen" if self.garbage_collector_frozen else "collected"
        return f"{self.priority}, memory lock {GRANT_TEXTS[self.memory_locked]}, {core}, garbage {garbage}"


def apply_realtime(
    requested: RealtimeSettings, priority: int, core_index: int, cpu_burst_us: int = WORKER_CPU_BURST_US
) -> RealtimeGrant:
    """Bound the memory of this process and ask for what the settings want; `place` is an index into their cores.

    Call in the main thread, once everything is loaded.
    """
    limit_memory()
    if requested.freeze_garbage:
        freeze_garbage_collector()
    return RealtimeGrant(
        priority=RealtimePriority(requested.priority, priority, cpu_burst_us),
        memory_locked=_lock_memory() if requested.lock_memory else None,
        core=_pin_to_core(requested.cores[core_index % len(requested.cores)]) if requested.cores else None,
        garbage_collector_frozen=requested.freeze_garbage,
    )


def take_server_priority(requested: bool) -> RealtimePriority:
    """Take real-time priority for a process that serves people and disks: before other programs of any session.

    Between sessions Linux shares each core evenly, however little one of them asks for (autogroups, sched(7)): beside a
    busy browser a server waited 0.5 s for its turn.
    """
    return RealtimePriority(requested, SERVER_PRIORITY, SERVER_CPU_BURST_US, hard_limit_s=None)


@dataclass(frozen=True, slots=True)
class ProcessActivity:
    """What a process does, as proc(5) shows it: the state of its main thread, and the processor time of all, ticks."""

    state: str
    cpu_ticks: int

    @property
    def is_suspended(self) -> bool:
        """Stopped by a signal or a debugger, or waiting for a disk or a swapped page."""
        return self.state in "TtD"

    @property
    def is_runnable(self) -> bool:
        return self.state == "R"


def read_activity(pid: int) -> ProcessActivity:
    """Read the activity of a process; one that does not exist is in state X, dead."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ProcessActivity("X", 0)
    return ProcessActivity(fields[0], int(fields[11]) + int(fields[12]))


def start_child_process(process: BaseProcess) -> None:
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


def _pin_to_core(core: int) -> int:
    """The core, or -1 where this process may not run on it."""
    try:
        _for_each_thread(lambda thread: os.sched_setaffinity(thread, {core}))
    except OSError:  # there is no such core, or not for this process
        return -1
    return core


@contextlib.contextmanager
def hold_realtime_priority(priority: int) -> Iterator[None]:
    """Take real-time priority for the duration of the block. Enter it in the main thread."""
    taken = RealtimePriority(True, priority, WORKER_CPU_BURST_US)
    try:
        yield
    finally:
        taken.restore_default()


def _set_scheduler(policy: int, priority: int) -> None:
    _for_each_thread(lambda thread: os.sched_setscheduler(thread, policy, os.sched_param(priority)))


def _for_each_thread(action: Callable[[int], None]) -> None:
    """Of this process, those of libraries included."""
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            action(int(thread))
