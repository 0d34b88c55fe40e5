"""Opens the source that a tool file asks for."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from acquisition.nidaq import NidaqTool, session_options
from config.load import holdable
from config.schema import TissueLibrary, Tool, ToolKind

if TYPE_CHECKING:
    from acquisition.simulation.grasper import SimulatedGrasper


def open_tool(
    tool: Tool, library: TissueLibrary, tissue: str, seed: int, *, virtual: bool = False
) -> tuple[NidaqTool, "SimulatedGrasper | None"]:
    """The tool behind its driver; for a simulated one also the grasper, whose tissue can be changed.

    With `virtual`, simulated time jumps as fast as the reader reads; otherwise it is the real one.
    """
    if tool.kind is ToolKind.NIDAQ:
        return NidaqTool(tool, session_options(tool)), None
    from acquisition.simulation.board import RealClock, SimulatedBoard, VirtualClock  # only where it is asked for
    from acquisition.simulation.grasper import SimulatedGrasper
    from acquisition.simulation.service import in_process_options

    grasper = SimulatedGrasper(tool, holdable(library), tissue, seed)
    board = SimulatedBoard(tool, grasper, VirtualClock() if virtual else RealClock())
    clock: Callable[[], int] = board.clock.now_ns if virtual else time.monotonic_ns
    return NidaqTool(tool, in_process_options(board), clock), grasper
