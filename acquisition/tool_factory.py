"""Functions that open the driver, the hardware check or the calibration bench of a tool file."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

import nidaqmx

from acquisition.bench.tool_check import HardwareCheck
from acquisition.drivers.nidaq import NidaqSource, create_session_options
from acquisition.drivers.source import LiveSource
from config.load import build_graspable_library, load_library, load_tool
from config.schema import TissueLibrary, Tool, ToolKind

if TYPE_CHECKING:
    from acquisition.bench.calibration_bench import CalibrationBench
    from acquisition.simulation.grasper import SimulatedGrasper


def open_tool(
    tool: Tool, library: TissueLibrary, tissue: str, seed: int, *, virtual: bool = False
) -> tuple[LiveSource, "SimulatedGrasper | None"]:
    """Return the tool's driver and, for a simulated tool, its grasper, whose tissue can be changed.

    With `virtual`, simulated time advances as fast as the caller reads; otherwise it is real time.
    """
    if tool.kind is ToolKind.NIDAQ:
        return NidaqSource(tool, create_session_options(tool)), None
    if tool.kind is ToolKind.SERIAL:
        from acquisition.drivers.serial_lines import SerialSource  # imports its library only where it is needed

        return SerialSource(tool), None
    options, clock, grasper = _build_simulated_tool(tool, library, tissue, seed, virtual)
    return NidaqSource(tool, options, clock), grasper


def open_hardware_check(
    tool: Tool, library: TissueLibrary, reading_context: AbstractContextManager[None]
) -> HardwareCheck:
    """Return the hardware check of a tool; the jaws of a simulated tool are empty."""
    if tool.kind is ToolKind.NIDAQ:
        return HardwareCheck(tool, create_session_options(tool), time.monotonic_ns, reading_context)
    options, clock, grasper = _build_simulated_tool(tool, library, next(iter(library.tissues)), seed=0, virtual=False)
    grasper.gauge_m = 0.0
    return HardwareCheck(tool, options, clock, reading_context)


def open_calibration_bench(
    tool: Tool, reading_context: Callable[[], AbstractContextManager[None]]
) -> "CalibrationBench":
    """Return the calibration bench of a tool; on a simulated tool it places weights and gauges itself."""
    from acquisition.bench.calibration_bench import CalibrationBench  # the acquisition worker does not need it

    if tool.kind is ToolKind.NIDAQ:
        return CalibrationBench(tool, create_session_options(tool), time.monotonic_ns, reading_context=reading_context)
    library = load_library("porcine")  # required by the grasper; its tissues are not used
    options, clock, grasper = _build_simulated_tool(tool, library, next(iter(library.tissues)), seed=0, virtual=False)

    def set_load(pull_n: float, gauge_m: float) -> None:
        grasper.handle_pull_n, grasper.gauge_m = pull_n, gauge_m

    return CalibrationBench(tool, options, clock, set_load, reading_context)


def _build_simulated_tool(
    tool: Tool, library: TissueLibrary, tissue: str, seed: int, virtual: bool
) -> tuple[nidaqmx.GrpcSessionOptions, Callable[[], int], "SimulatedGrasper"]:
    """Return the session options and the clock of a simulated board, and its grasper."""
    from acquisition.simulation.board import RealClock, SimulatedBoard, VirtualClock  # for simulated tools only
    from acquisition.simulation.grasper import SimulatedGrasper
    from acquisition.simulation.service import create_in_process_options

    grasper = SimulatedGrasper(tool, build_graspable_library(library), tissue, seed)
    # The board is wired as the shipped file says, so that a mistake in another file shows as on a real board.
    wired = load_tool("simulated")
    as_wired = tool.model_copy(update={"board": wired.board, "channels": wired.channels})
    board = SimulatedBoard(as_wired, grasper, VirtualClock() if virtual else RealClock())
    clock: Callable[[], int] = board.clock.now_ns if virtual else time.monotonic_ns
    return create_in_process_options(board), clock, grasper
