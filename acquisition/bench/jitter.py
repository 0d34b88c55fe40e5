"""How late blocks are read and conditioned, in a process of its own with what `[realtime]` asks for."""

import multiprocessing
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np

from acquisition.bench.checks import lateness_ms
from acquisition.bench.jaws import blocks_in
from acquisition.pipeline import Acquisition
from acquisition.process import take_realtime
from acquisition.tools import open_tool
from acquisition.worker import REALTIME_PRIORITY
from config.errors import ToolError
from config.schema import Realtime, Settings, TissueLibrary, Tool

SETTLING_S = 1.0
QUANTILES = {"median": 0.5, "p99": 0.99, "p99_9": 0.999, "longest": 1.0}


@dataclass(frozen=True, slots=True)
class Jitter:
    """Lateness of blocks, ms, by the names of QUANTILES; and what the system granted."""

    late_ms: dict[str, float]
    blocks: int
    granted: str


def measure(tool: Tool, library: TissueLibrary, settings: Settings, wanted: Realtime, seconds: float) -> Jitter:
    """Read the tool at rest, motor at zero.

    Raises:
        ToolError: the tool cannot be opened, or a block came too late for it to go on.
    """
    near, far = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=_read, args=(tool, library, settings, wanted, seconds, far))
    process.start()
    far.close()
    try:
        found = near.recv()
    except EOFError:
        found = "The process that measured was ended from outside: measure again."
    process.join()
    if isinstance(found, str):
        raise ToolError(found)
    return found


def _read(
    tool: Tool, library: TissueLibrary, settings: Settings, wanted: Realtime, seconds: float, line: Connection
) -> None:  # fmt: skip
    source, _ = open_tool(tool, library, next(iter(library.tissues)), seed=0)
    try:
        with source:
            acquisition = Acquisition(source, tool, settings.conditioning)
            granted = take_realtime(wanted, REALTIME_PRIORITY, place=0)
            for _ in range(blocks_in(SETTLING_S, tool)):
                acquisition.turn()
            blocks = blocks_in(seconds, tool)
            ticks, done_ns = np.empty(blocks), np.empty(blocks, np.int64)
            for n in range(blocks):
                block = acquisition.turn()
                ticks[n], done_ns[n] = block.samples["tick"][-1], time.monotonic_ns()
    except ToolError as error:
        line.send(str(error))
        return
    late_ms = lateness_ms(ticks, done_ns)[1]
    line.send(Jitter({name: float(np.quantile(late_ms, at)) for name, at in QUANTILES.items()}, blocks, str(granted)))


@contextmanager
def load(on: bool) -> Iterator[None]:
    """Meanwhile, one program a core that only computes."""
    context = multiprocessing.get_context("spawn")
    programs = [context.Process(target=_compute, daemon=True) for _ in range((os.cpu_count() or 1) if on else 0)]
    for program in programs:
        program.start()
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.join()


def _compute() -> None:
    while True:
        pass
