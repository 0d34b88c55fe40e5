"""The function that resets a board whose worker died, which brings the motor to zero."""

import asyncio
from collections.abc import Callable

from acquisition.drivers.nidaq import reset_device
from config.errors import ToolError
from config.schema import Tool

RESET_TIMEOUT_S = 3.0
RESET_RETRY_S = 0.05


async def zero_motor(tool: Tool, on_fault: Callable[[str | None], None]) -> None:
    """Reset the board: it holds its last output when its owner dies, and only a reset brings it to zero.

    `on_fault` receives each error, or None once the motor is at zero.
    """
    if not tool.has_real_motor:
        return
    try:
        async with asyncio.timeout(RESET_TIMEOUT_S):
            while not await _reset_board(tool, on_fault):
                await asyncio.sleep(RESET_RETRY_S)
    except TimeoutError:
        on_fault("The board does not answer to a reset: switch off the motor's amplifier NOW.")


async def _reset_board(tool: Tool, on_fault: Callable[[str | None], None]) -> bool:
    try:
        await asyncio.to_thread(reset_device, tool)
    except ToolError as error:
        on_fault(str(error))
        return False
    on_fault(None)
    return True
