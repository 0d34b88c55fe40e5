"""How late blocks are read and conditioned, in a process of its own with what `[realtime]` asks for."""

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from acquisition.bench.checks import lateness_ms
from acquisition.bench.jaws import blocks_in
from acquisition.control import Acquisition
from acquisition.nidaq import NidaqTool
from acquisition.process import take_realtime
from config.errors import ToolError
from config.schema import Realtime, Settings, TissueLibrary, Tool

SETTLING_S = 1.0
Opens = Callable[[Tool, TissueLibrary, str, int], tuple[NidaqTool, Any]]
QUANTILES = {"median": 0.5, "p99": 0.99, "p99_9": 0.999, "longest": 1.0}


@dataclass(frozen=True, slots=True)
class Jitter:
    """Lateness of blocks, ms, by the names of QUANTILES; what the system granted; what ended the tool early."""

    late_ms: dict[str, float]
    blocks: int
    granted: str
    ended: str | None


def measure(
    open_tool: Opens,
    tool: Tool,
    library: TissueLibrary,
    settings: Settings,
    wanted: Realtime,
    priority: int,
    seconds: float,
) -> Jitter:
    """Read the tool at rest, motor at zero; `priority` is the acquisition's.

    Raises:
        ToolError: the tool cannot be opened.
    """
    near, far = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=_read, args=(open_tool, tool, library, settings, wanted, priority, seconds, far))
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
    open_tool: Opens,
    tool: Tool,
    library: TissueLibrary,
    settings: Settings,
    wanted: Realtime,
    priority: int,
    seconds: float,
    line: Connection,
) -> None:
    source, _ = open_tool(tool, library, next(iter(library.tissues)), 0)
    most, blocks, ended = blocks_in(seconds, tool), 0, None
    ticks, done_ns = np.empty(most), np.empty(most, np.int64)
    try:
        with source:
            acquisition = Acquisition(source, tool, settings.conditioning)
            granted = take_realtime(wanted, priority, place=0)
            for _ in range(blocks_in(SETTLING_S, tool)):
                acquisition.turn()
            while blocks < most:
                granted.priority.renew()
                block = acquisition.turn()
                ticks[blocks], done_ns[blocks] = block.samples["tick"][-1], time.monotonic_ns()
                blocks += 1
    except ToolError as error:
        ended = str(error)
    if blocks < 2:
        line.send(ended)
        return
    late_ms = lateness_ms(ticks[:blocks], done_ns[:blocks])[1]
    quantiles = {name: float(np.quantile(late_ms, at)) for name, at in QUANTILES.items()}
    line.send(Jitter(quantiles, blocks, str(granted), ended))


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
