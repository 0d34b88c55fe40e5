"""Functions for processes of a service: end with the parent or on a signal, memory limit, priority, activity."""

import atexit
import contextlib
import ctypes
import gc
import multiprocessing
import os
import pickle
import resource
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import DupFd, ForkingPickler
from pathlib import Path
from types import FrameType
from typing import Any, Self

from config.schema import RealtimeSettings

PR_SET_PDEATHSIG = 1
PR_SET_NAME = 15
MCL_CURRENT, MCL_FUTURE = 1, 2
MEMORY_HEADROOM_BYTES = 512 << 20
"""Memory that a worker may add after its start; beyond it the worker fails instead of exhausting the machine."""
START_HEADROOM_BYTES = 2 * MEMORY_HEADROOM_BYTES
"""The same for its start; compiling the filters takes 300 MB."""
WORKER_CPU_BURST_US = 300_000
"""Longest computation at real-time priority without a pause; the blocks of one second take 80,000 us."""
SERVER_PRIORITY = 10
"""Of the server, which carries STOP, and of the recorder: below acquisition, estimator and safety monitor."""
SERVER_CPU_BURST_US = 1_000_000
HARD_CPU_LIMIT_S = 5
"""The kernel kills a worker that computes for so long at real-time priority inside one call of a library."""
MIN_HARD_LIMIT_BURSTS = 2
"""With a lower hard limit of the system (RLIMIT_RTTIME), real-time priority counts as refused."""
GRANT_TEXTS = {True: "granted", False: "refused", None: "not asked for"}


class ProcessEndFlag:
    """Flag set by SIGTERM and SIGINT. A worker checks it once a turn, so that it ends with the motor at zero.

    SIGHUP, which reaches all processes of a terminal, is left to the parent: it would take the ends for deaths.
    """

    def __init__(self) -> None:
        self.is_set = False
        signal.signal(signal.SIGTERM, self._on_signal)
        signal.signal(signal.SIGINT, self._on_signal)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.is_set = True


def initialize_worker(name: str, parent_pid: int) -> ProcessEndFlag:
    """Tie this process to its parent, set its name for `ps` and `top`, and return the flag that its signals set."""
    flag = ProcessEndFlag()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    libc.prctl(PR_SET_NAME, name.encode())
    if os.getppid() != parent_pid:  # the parent died before the line above
        flag.is_set = True
    return flag


def limit_memory(headroom_bytes: int = MEMORY_HEADROOM_BYTES) -> None:
    """Limit the memory of this process to its present size and `headroom_bytes`."""
    status = Path("/proc/self/status").read_text()
    now_kb = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmData:"))
    bound = now_kb * 1024 + headroom_bytes
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (bound if most == resource.RLIM_INFINITY else min(bound, most), most))


def freeze_garbage_collector() -> None:
    """Freeze existing objects and disable the collector, whose full collection took 31 ms."""
    gc.collect()
    gc.freeze()
    gc.disable()


class RealtimePriority:
    """Real-time priority (SCHED_FIFO) of all threads of this process, lowered while it computes without a pause.

    A real-time thread that computes without end takes a core from all other programs. After `cpu_burst_us` the kernel
    sends SIGXCPU, and the process falls back to the usual priority instead of ending: it may have a backlog to process.
    `renew` raises the priority again; the kernel's count restarts once the process has waited.
    """

    def __init__(
        self, requested: bool, priority: int, cpu_burst_us: int, hard_limit_s: int | None = HARD_CPU_LIMIT_S
    ) -> None:
        """Raise the priority if it is requested and the system grants it. Call in the main thread.

        After `hard_limit_s` without a pause, for example inside one call of a library, the kernel kills the process
        (SIGKILL); None: never.
        """
        self._priority, self._cpu_burst_us = priority, cpu_burst_us
        self._hard_limit_us = resource.RLIM_INFINITY if hard_limit_s is None else hard_limit_s * 1_000_000
        self.granted: bool | None = None
        self.times_lowered, self._is_lowered = 0, False
        if requested:
            signal.signal(signal.SIGXCPU, self._on_cpu_limit)
            atexit.register(self.restore_default)  # the interpreter's end resets the handler: SIGXCPU would then kill
            self.granted = self._raise_priority()

    def __str__(self) -> str:
        lowered = f", lowered {self.times_lowered} times" if self.times_lowered else ""
        return f"priority {GRANT_TEXTS[self.granted]}{lowered}"

    def renew(self) -> None:
        """Raise the priority again if it was lowered. Call about once a second from the process's main loop."""
        if self._is_lowered:
            self._is_lowered = False
            self._raise_priority()

    def restore_default(self) -> None:
        if self.granted:
            _set_scheduler(os.SCHED_OTHER, 0)

    def _raise_priority(self) -> bool:
        _, most = resource.getrlimit(resource.RLIMIT_RTTIME)
        most = self._hard_limit_us if most == resource.RLIM_INFINITY else most  # a lower limit of the system stays
        if most != resource.RLIM_INFINITY and most < MIN_HARD_LIMIT_BURSTS * self._cpu_burst_us:
            return False  # the kernel would kill this process before it can fall back
        try:
            resource.setrlimit(resource.RLIMIT_RTTIME, (self._cpu_burst_us, most))
            _set_scheduler(os.SCHED_FIFO, self._priority)
        except (OSError, ValueError):  # ValueError: the limit was lowered meanwhile
            return False
        return True

    def _on_cpu_limit(self, number: int, frame: FrameType | None) -> None:
        self.times_lowered, self._is_lowered = self.times_lowered + 1, True
        _set_scheduler(os.SCHED_OTHER, 0)


@dataclass(frozen=True, slots=True)
class RealtimeGrant:
    """Real-time properties that the system granted a worker; None: not requested."""

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
    """Limit the memory of this process and apply the settings' requests; `core_index` selects one of their cores.

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
    """Raise the priority of this server or recorder process over programs of other sessions, and return it.

    Between sessions Linux shares each core evenly, even if one of them needs little (autogroups, sched(7)): beside a
    busy browser a server waited 0.5 s for its turn.
    """
    return RealtimePriority(requested, SERVER_PRIORITY, SERVER_CPU_BURST_US, hard_limit_s=None)


@dataclass(frozen=True, slots=True)
class ProcessSnapshot:
    """Snapshot of any process from /proc: its main thread's state, and its processor time in clock ticks, proc(5)."""

    state: str
    cpu_ticks: int

    @property
    def is_suspended(self) -> bool:
        """Whether the process is stopped by a signal or a debugger, or waits for a disk or a swapped page."""
        return self.state in "TtD"

    @property
    def is_runnable(self) -> bool:
        return self.state == "R"


def read_process_snapshot(pid: int) -> ProcessSnapshot:
    """Return a snapshot of the process `pid`; a process that does not exist is in state X, dead."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ProcessSnapshot("X", 0)
    return ProcessSnapshot(fields[0], int(fields[11]) + int(fields[12]))


def start_child_process(name: str, main: Callable[..., object], *arguments: Any) -> BaseProcess:
    """Start `main(*arguments)` in a process, at the usual priority, and return it without waiting until it has loaded.

    Raises:
        OSError: the system refuses a process or its memory.
    """
    # Python's resource tracker, which starts with the first process, must outlive SIGHUP, or Python warns of its death.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    try:
        resource_tracker.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    with _InheritedArguments(arguments) as inherited:
        process = multiprocessing.get_context("spawn").Process(target=_run_child, args=(main, inherited), name=name)
        process.start()
    assert process.pid is not None
    with contextlib.suppress(ProcessLookupError):
        os.sched_setscheduler(process.pid, os.SCHED_OTHER, os.sched_param(0))
    return process


def _run_child(main: Callable[..., object], arguments: tuple[Any, ...]) -> None:
    try:
        main(*arguments)
    finally:
        gc.freeze()  # otherwise the interpreter takes half a second to collect all modules before it ends


class _InheritedArguments:
    """Arguments of a process, in a file in memory that it inherits; in the process they are a tuple again.

    multiprocessing sends arguments through a pipe. Above its 64 KiB `start` would wait until the process has loaded,
    and for ever if the process is killed meanwhile, because the parent itself keeps the pipe's other end open.
    """

    def __init__(self, arguments: tuple[Any, ...]) -> None:
        self._arguments = arguments
        self._file = os.fdopen(os.memfd_create("arguments"), "wb")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __reduce__(self) -> tuple[Callable[..., tuple[Any, ...]], tuple[Any, ...]]:
        self._file.write(ForkingPickler.dumps(self._arguments))
        self._file.flush()
        return _read_arguments, (DupFd(self._file.fileno()),)


def _read_arguments(inherited: Any) -> tuple[Any, ...]:
    with os.fdopen(inherited.detach(), "rb") as file:
        file.seek(0)
        return pickle.load(file)


def _lock_memory() -> bool:
    """Lock all memory if no limit on locked memory can refuse later allocations; return whether it is locked."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != resource.RLIM_INFINITY and os.geteuid() != 0:
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    return libc.mlockall(MCL_CURRENT | MCL_FUTURE) == 0


def _pin_to_core(core: int) -> int:
    """Pin all threads to a core; return the core, or -1 if it does not exist or is not allowed."""
    try:
        _for_each_thread(lambda thread: os.sched_setaffinity(thread, {core}))
    except OSError:
        return -1
    return core


@contextlib.contextmanager
def hold_realtime_priority(priority: int) -> Iterator[None]:
    """Raise this process to real-time priority inside the `with` block. Enter it in the main thread."""
    taken = RealtimePriority(True, priority, WORKER_CPU_BURST_US)
    try:
        yield
    finally:
        taken.restore_default()


def _set_scheduler(policy: int, priority: int) -> None:
    _for_each_thread(lambda thread: os.sched_setscheduler(thread, policy, os.sched_param(priority)))


def _for_each_thread(action: Callable[[int], None]) -> None:
    """Call `action` with the id of each thread of this process, including threads of libraries."""
    for thread in os.listdir("/proc/self/task"):
        with contextlib.suppress(ProcessLookupError):  # the thread has ended meanwhile
            action(int(thread))
