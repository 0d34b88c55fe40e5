"""Opens the source that a tool file asks for."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

import nidaqmx

from acquisition.bench.tool_check import HardwareCheck
from acquisition.drivers.nidaq import NidaqSource, create_session_options
from config.load import build_graspable_library, load_library
from config.schema import TissueLibrary, Tool, ToolKind

if TYPE_CHECKING:
    from acquisition.bench.readings import CalibrationBench
    from acquisition.simulation.grasper import SimulatedGrasper


def open_tool(
    tool: Tool, library: TissueLibrary, tissue: str, seed: int, *, virtual: bool = False
) -> tuple[NidaqSource, "SimulatedGrasper | None"]:
    """The tool behind its driver; for a simulated one also the grasper, whose tissue can be changed.

    With `virtual`, simulated time jumps as fast as the reader reads; otherwise it is the real one.
    """
    if tool.kind is ToolKind.NIDAQ:
        return NidaqSource(tool, create_session_options(tool)), None
    options, clock, grasper = _build_simulated_tool(tool, library, tissue, seed, virtual)
    return NidaqSource(tool, options, clock), grasper


def open_hardware_check(
    tool: Tool, library: TissueLibrary, reading_context: AbstractContextManager[None]
) -> HardwareCheck:
    """The tool to be checked, see `Walk`; the jaws of a simulated one are empty."""
    if tool.kind is ToolKind.NIDAQ:
        return HardwareCheck(tool, create_session_options(tool), time.monotonic_ns, reading_context)
    options, clock, grasper = _build_simulated_tool(tool, library, next(iter(library.tissues)), seed=0, virtual=False)
    grasper.gauge_m = 0.0
    return HardwareCheck(tool, options, clock, reading_context)


def open_calibration_bench(
    tool: Tool, reading_context: Callable[[], AbstractContextManager[None]]
) -> "CalibrationBench":
    """The tool to be calibrated, see `Bench`; on a simulated one weights and gauges are put by themselves."""
    from acquisition.bench.readings import CalibrationBench  # the worker has no use for it

    if tool.kind is ToolKind.NIDAQ:
        return CalibrationBench(tool, create_session_options(tool), time.monotonic_ns, reading_context=reading_context)
    library = load_library("porcine")  # nothing of it is held
    options, clock, grasper = _build_simulated_tool(tool, library, next(iter(library.tissues)), seed=0, virtual=False)

    def set_load(pull_n: float, gauge_m: float) -> None:
        grasper.handle_pull_n, grasper.gauge_m = pull_n, gauge_m

    return CalibrationBench(tool, options, clock, set_load, reading_context)


def _build_simulated_tool(
    tool: Tool, library: TissueLibrary, tissue: str, seed: int, virtual: bool
) -> tuple[nidaqmx.GrpcSessionOptions, Callable[[], int], "SimulatedGrasper"]:
    """How the simulated board is reached, its clock, and its grasper."""
    from acquisition.simulation.board import RealClock, SimulatedBoard, VirtualClock  # only where it is asked for
    from acquisition.simulation.grasper import SimulatedGrasper
    from acquisition.simulation.service import create_in_process_options

    grasper = SimulatedGrasper(tool, build_graspable_library(library), tissue, seed)
    board = SimulatedBoard(tool, grasper, VirtualClock() if virtual else RealClock())
    clock: Callable[[], int] = board.clock.now_ns if virtual else time.monotonic_ns
    return create_in_process_options(board), clock, grasper
