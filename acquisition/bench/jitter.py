"""Functions that measure how late blocks are read and conditioned, in a process with the settings of `[realtime]`."""

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from acquisition.acquisition_loop import AcquisitionController
from acquisition.bench.checks import measure_rate_and_lateness
from acquisition.bench.jaw_motion import convert_seconds_to_blocks
from acquisition.drivers.source import LiveSource
from acquisition.worker_process import RealtimeGrant, apply_realtime, start_child_process
from config.errors import ToolError
from config.schema import RealtimeSettings, Settings, TissueLibrary, Tool

SETTLING_S = 1.0
ToolOpener = Callable[[Tool, TissueLibrary, str, int], tuple[LiveSource, Any]]
QUANTILES = {"median": 0.5, "p99": 0.99, "p99_9": 0.999, "longest": 1.0}


@dataclass(frozen=True, slots=True)
class Jitter:
    """Lateness of blocks, ms, by the names of QUANTILES; granted priority; the error that ended the tool early."""

    late_ms: dict[str, float]
    blocks: int
    granted: str
    ended: str | None


def measure_jitter(
    open_tool: ToolOpener,
    tool: Tool,
    library: TissueLibrary,
    settings: Settings,
    requested: RealtimeSettings,
    priority: int,
    seconds: float,
) -> Jitter:
    """Measure how late the blocks of a tool at rest are read, motor at zero; `priority` is the acquisition's.

    Raises:
        ToolError: the tool cannot be opened.
    """
    near, far = multiprocessing.Pipe()
    process = start_child_process(
        "graspwatch-jitter", _measure_in_process, open_tool, tool, library, settings, requested, priority, seconds, far
    )
    far.close()
    try:
        found = near.recv()
    except EOFError:
        found = "The process that measured was ended from outside: measure again."
    process.join()
    if isinstance(found, str):
        raise ToolError(found)
    return found


def _measure_in_process(
    open_tool: ToolOpener,
    tool: Tool,
    library: TissueLibrary,
    settings: Settings,
    wanted: RealtimeSettings,
    priority: int,
    seconds: float,
    line: Connection,
) -> None:
    source, _ = open_tool(tool, library, next(iter(library.tissues)), 0)
    most, blocks, ended = convert_seconds_to_blocks(seconds, tool), 0, None
    ticks, done_ns = np.empty(most), np.empty(most, np.int64)
    granted: RealtimeGrant | None = None
    try:
        with source:
            acquisition = AcquisitionController(source, tool, settings.conditioning)
            granted = apply_realtime(wanted, priority, core_index=0)
            for _ in range(convert_seconds_to_blocks(SETTLING_S, tool)):
                acquisition.process_block()
            while blocks < most:
                granted.priority.renew()
                block = acquisition.process_block()
                assert block is not None  # a board's samples do not end
                ticks[blocks], done_ns[blocks] = block.samples["tick"][-1], time.monotonic_ns()
                blocks += 1
    except ToolError as error:
        ended = str(error)
    if granted is None or blocks < 2:
        line.send(ended)
        return
    late_ms = measure_rate_and_lateness(ticks[:blocks], done_ns[:blocks])[1]
    quantiles = {name: float(np.quantile(late_ms, at)) for name, at in QUANTILES.items()}
    line.send(Jitter(quantiles, blocks, str(granted), ended))


@contextmanager
def keep_cores_busy(on: bool) -> Iterator[None]:
    """If `on`, keep every CPU core busy inside the `with` block, each with an endless computation."""
    context = multiprocessing.get_context("spawn")
    programs = [
        context.Process(target=_compute_forever, daemon=True) for _ in range((os.cpu_count() or 1) if on else 0)
    ]
    for program in programs:
        program.start()
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.join()


def _compute_forever() -> None:
    while True:
        pass
