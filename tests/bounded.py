"""Run work in a process with a limit on further memory."""

import multiprocessing
import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

from config.errors import GraspwatchError


def fault_within(extra_bytes: int, work: Callable[..., object], *arguments: Any) -> str:
    """Return the user's error message of the work; empty if it succeeds. A MemoryError fails the test."""
    answers: multiprocessing.SimpleQueue[str] = multiprocessing.SimpleQueue()
    process = multiprocessing.get_context("fork").Process(
        target=_limited, args=(answers, extra_bytes, work, *arguments)
    )
    process.start()
    process.join(60)
    assert process.exitcode == 0, f"it ended with {process.exitcode}"
    return answers.get()


def _limited(
    answers: "multiprocessing.SimpleQueue[str]", extra_bytes: int, work: Callable[..., object], *arguments: Any
) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + extra_bytes,) * 2)
    try:
        work(*arguments)
    except GraspwatchError as error:
        answers.put(str(error))
    else:
        answers.put("")
