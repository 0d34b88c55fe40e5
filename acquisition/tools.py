"""Opens the source that a tool file asks for."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

import nidaqmx

from acquisition.bench.walk import Walk
from acquisition.nidaq import NidaqTool, session_options
from config.load import holdable, load_library
from config.schema import TissueLibrary, Tool, ToolKind

if TYPE_CHECKING:
    from acquisition.bench.measuring import Bench
    from acquisition.simulation.grasper import SimulatedGrasper


def open_tool(
    tool: Tool, library: TissueLibrary, tissue: str, seed: int, *, virtual: bool = False
) -> tuple[NidaqTool, "SimulatedGrasper | None"]:
    """The tool behind its driver; for a simulated one also the grasper, whose tissue can be changed.

    With `virtual`, simulated time jumps as fast as the reader reads; otherwise it is the real one.
    """
    if tool.kind is ToolKind.NIDAQ:
        return NidaqTool(tool, session_options(tool)), None
    options, clock, grasper = _simulated(tool, library, tissue, seed, virtual)
    return NidaqTool(tool, options, clock), grasper


def open_bench(tool: Tool, library: TissueLibrary, reading: AbstractContextManager[None]) -> Walk:
    """The tool to be checked, see `Walk`; the jaws of a simulated one are empty."""
    if tool.kind is ToolKind.NIDAQ:
        return Walk(tool, session_options(tool), time.monotonic_ns, reading)
    options, clock, grasper = _simulated(tool, library, next(iter(library.tissues)), seed=0, virtual=False)
    grasper.gauge_m = 0.0
    return Walk(tool, options, clock, reading)


def open_for_calibration(tool: Tool, reading: Callable[[], AbstractContextManager[None]]) -> "Bench":
    """The tool to be calibrated, see `Bench`; on a simulated one weights and gauges are put by themselves."""
    from acquisition.bench.measuring import Bench  # the worker has no use for it

    if tool.kind is ToolKind.NIDAQ:
        return Bench(tool, session_options(tool), time.monotonic_ns, reading=reading)
    library = load_library("porcine")  # nothing of it is held
    options, clock, grasper = _simulated(tool, library, next(iter(library.tissues)), seed=0, virtual=False)

    def put(pull_n: float, gauge_m: float) -> None:
        grasper.hung_n, grasper.gauge_m = pull_n, gauge_m

    return Bench(tool, options, clock, put, reading)


def _simulated(
    tool: Tool, library: TissueLibrary, tissue: str, seed: int, virtual: bool
) -> tuple[nidaqmx.GrpcSessionOptions, Callable[[], int], "SimulatedGrasper"]:
    """How the simulated board is reached, its clock, and its grasper."""
    from acquisition.simulation.board import RealClock, SimulatedBoard, VirtualClock  # only where it is asked for
    from acquisition.simulation.grasper import SimulatedGrasper
    from acquisition.simulation.service import in_process_options

    grasper = SimulatedGrasper(tool, holdable(library), tissue, seed)
    board = SimulatedBoard(tool, grasper, VirtualClock() if virtual else RealClock())
    clock: Callable[[], int] = board.clock.now_ns if virtual else time.monotonic_ns
    return in_process_options(board), clock, grasper
