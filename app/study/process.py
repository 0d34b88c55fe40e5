"""A study in a process of its own: it gives way to a live tool, and ends with all its children when it is told to, and
when the service ends, however that ends."""

import asyncio
import contextlib
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType

from acquisition.process import become_worker
from config.errors import GraspwatchError
from estimator.studies.catalogue import STUDIES

NICENESS = 10
SAYS_EVERY_S = 0.1


@dataclass(frozen=True, slots=True)
class Job:
    """What is to be carried out, and the folder for its page and its JSON."""

    study: str
    grasps: int
    seed: int
    folder: Path


class StudyProcess:
    """Carries out a job; lives in the event loop that made it."""

    def __init__(self, job: Job, on_progress: Callable[[int, int], None], on_end: Callable[[str | None], None]) -> None:
        """Start. `on_progress(done, of)` is called as cases are done, `on_end(why)` once; why is None if all went well.

        Raises:
            OSError: the system has no room for a process.
        """
        self._on_progress, self._on_end = on_progress, on_end
        self._why: str | None = None
        self._over = asyncio.Event()
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe(duplex=False)
        self._process = context.Process(target=_main, args=(job, theirs, os.getpid()), name="graspwatch-study")
        with theirs:
            self._process.start()
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._pipe.fileno(), self._read)
        self._loop.add_reader(self._process.sentinel, self._end)

    def kill(self) -> None:
        """End it and its children at once; nothing they hold needs an orderly end."""
        self._process.kill()  # it may not have become a group yet: then it has no children either
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    async def wait(self) -> None:
        """Until it has ended and `on_end` was called."""
        await self._over.wait()

    def _read(self) -> None:
        try:
            while self._pipe.poll():
                self._take(self._pipe.recv())
        except EOFError:
            self._loop.remove_reader(self._pipe.fileno())

    def _take(self, message: tuple[int, int] | str) -> None:
        if isinstance(message, str):
            self._why = message
        else:
            self._on_progress(*message)

    def _end(self) -> None:
        self._read()
        self._loop.remove_reader(self._process.sentinel)
        self._loop.remove_reader(self._pipe.fileno())
        self.kill()  # children that outlived it
        self._process.join()
        self._pipe.close()
        code = self._process.exitcode
        if code:
            self._why = self._why or _death(code)
        self._over.set()
        self._on_end(self._why)


def _death(code: int) -> str:
    if code == -signal.SIGKILL:
        return "Its process was killed; the machine may have run out of memory. Start it again with fewer grasps."
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    return f"Its process died ({how}); the service's error output says more. Start it again."


# --- in the process -----------------------------------------------------------------------------------------------


def _main(job: Job, pipe: Connection, service_pid: int) -> None:
    _give_way(service_pid)
    entry = STUDIES[job.study]
    try:
        from estimator.studies.course import Bench

        jobs = max((os.cpu_count() or 1) - 1, 1)
        study = entry.carry_out(Bench(), job.grasps, job.seed, _Progress(pipe), jobs)
    except GraspwatchError as error:
        pipe.send(str(error))
        sys.exit(error.exit_code)
    try:
        study.write(job.folder)
    except OSError as error:
        pipe.send(f"Its report cannot be written to {job.folder} ({error.strerror}). Make room, then start it again.")
        sys.exit(1)


def _give_way(service_pid: int) -> None:
    """Low priority, and one group with all children to come, which ends when the service has ended.

    A group and not a session: between sessions Linux may share the processor evenly, whatever their niceness
    (autogroups, sched(7)).
    """
    os.setpgid(0, 0)
    os.nice(NICENESS)
    flag = become_worker("study", service_pid)
    signal.signal(signal.SIGTERM, _end_group)
    if flag.set:  # it was to end before the line above
        _end_group()


def _end_group(number: int = 0, frame: FrameType | None = None) -> None:
    os.killpg(0, signal.SIGKILL)


class _Progress:
    """Tells the service, ten times a second at most, so that cases are not slowed down by it."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._due_s = 0.0

    def __call__(self, done: int, of: int) -> None:
        if done in (0, of) or time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + SAYS_EVERY_S
            self._pipe.send((done, of))
