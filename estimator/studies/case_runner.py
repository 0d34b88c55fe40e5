"""Run a study's cases on all cores and report progress."""

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from config.errors import GraspwatchError

CaseT = TypeVar("CaseT")
ResultT = TypeVar("ResultT")
Progress = Callable[[int, int], None]  # done, total


def run_cases(
    work: Callable[[CaseT], ResultT], cases: Iterable[CaseT], progress: Progress, jobs: int | None = None
) -> list[ResultT]:
    """Run `work` (a function of a module, for other processes) on each case; return results in the cases' order.

    Raises:
        GraspwatchError: a process died.
    """
    todo: Sequence[CaseT] = list(cases)
    jobs = jobs or os.cpu_count() or 1
    progress(0, len(todo))
    results: list[ResultT] = []
    pool = ProcessPoolExecutor(jobs)
    try:
        for result in pool.map(work, todo, chunksize=max(1, min(16, len(todo) // (4 * jobs)))):
            results.append(result)
            progress(len(results), len(todo))
    except BrokenProcessPool:
        raise GraspwatchError(
            f"A process of the study died after {len(results)} of {len(todo)} cases; the machine may have run out of "
            "memory. Repeat it with fewer --jobs."
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)
    return results
