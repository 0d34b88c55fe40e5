"""The function that runs a study's cases on all cores and reports progress."""

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from config.errors import GraspwatchError, ServiceError

CaseT = TypeVar("CaseT")
ResultT = TypeVar("ResultT")
Progress = Callable[[int, int], None]  # done, total


def run_cases(
    work: Callable[[CaseT], ResultT], cases: Iterable[CaseT], progress: Progress, jobs: int | None = None
) -> list[ResultT]:
    """Run `work` (a function of a module, for other processes) on each case; return results in the cases' order.

    One job runs in this process if the system refuses another.

    Raises:
        GraspwatchError: a process died, or the system refuses processes or their shared memory.
    """
    todo: Sequence[CaseT] = list(cases)
    jobs = jobs or os.cpu_count() or 1
    progress(0, len(todo))
    results: list[ResultT] = []
    with contextlib.ExitStack() as pools:
        try:
            for result in _start(work, todo, jobs, pools):
                results.append(result)
                progress(len(results), len(todo))
        except BrokenProcessPool:
            raise GraspwatchError(
                f"A process of the study died after {len(results)} of {len(todo)} cases; the machine may have run out "
                "of memory. Repeat it with fewer --jobs."
            ) from None
        except BaseException:  # Ctrl+C, SIGTERM, SIGHUP, or an error of a case: nobody waits for the cases under way
            _end_case_processes()
            raise
    return results


def _start(
    work: Callable[[CaseT], ResultT], todo: Sequence[CaseT], jobs: int, pools: contextlib.ExitStack
) -> Iterator[ResultT]:
    """Return an iterator over the results, in order; a pool of processes that computes them ends with `pools`."""
    try:
        pool = ProcessPoolExecutor(jobs, initializer=_initialize_case_process)
        pools.callback(_shut_down, pool)
        return pool.map(work, todo, chunksize=max(1, min(16, len(todo) // (4 * jobs))))
    except OSError as error:
        if jobs == 1:
            return map(work, todo)
        raise ServiceError(
            f"The system refuses {jobs} processes that share memory ({error.strerror}). Give the program /dev/shm and "
            "more processes (`ulimit -u`), or repeat it with --jobs 1."
        ) from None


def _shut_down(pool: ProcessPoolExecutor) -> None:
    with contextlib.suppress(RuntimeError):  # a signal came while the pool's thread was starting
        pool.shutdown(cancel_futures=True)


def _end_case_processes() -> None:
    for process in multiprocessing.active_children():
        process.terminate()


def _initialize_case_process() -> None:
    """Leave Ctrl+C to the parent, and end at once on other signals."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
