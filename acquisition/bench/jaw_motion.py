"""The class EmptyJaws, which drives the empty jaws of an open board step by step for `graspwatch check`."""

import contextlib
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection

import numpy as np

from acquisition.bench.checks import RawSignals
from acquisition.drivers.command_history import AppliedCommand
from acquisition.drivers.nidaq import NidaqSource, read_driver_version, reset_device
from acquisition.drivers.source import RawBlock
from acquisition.worker_process import start_child_process
from config.errors import ToolError
from config.schema import Tool

CLOSING_COMMAND_V = 0.5
"""0.8 N on the Smart Tool, a third of the lowest injury threshold."""
RAMP_STEP_V = 0.01  # in one block
CLOSING_TIMEOUT_S = 3.0  # for the jaws to shut
STANDSTILL_BLOCKS, STANDSTILL_DEG = 40, 0.1
LEVEL_BLOCKS, SETTLING_BLOCKS = 40, 16
MAX_STRAIN_V = 0.4
"""Over rest: 2 to 3 N, more than this motion needs."""


class EmptyJaws:
    """The empty jaws of an open board, which its methods drive. `rest_v` is the strain gage's voltage at rest."""

    def __init__(self, source: NidaqSource, tool: Tool, rest_v: float) -> None:
        self._source, self._tool, self._rest_v = source, tool, rest_v

    def read_block(self) -> RawBlock:
        """Return the next block.

        Raises:
            ToolError: the force is larger than empty jaws can have; the motor is at zero.
        """
        block = self._source.read_block()
        strain_v = float(np.median(block.signals["strain_v"])) - self._rest_v
        if not abs(strain_v) < MAX_STRAIN_V:
            self._source.write_command(0.0)
            raise ToolError(
                f"The strain gage rose by {strain_v:.2f} V under {CLOSING_COMMAND_V} V, more than empty jaws do: the "
                f"motor is at "
                "zero. Look what is in the jaws, and check gain, sign and cable of the amplifier."
            )
        return block

    def close(self) -> float:
        """Close the jaws until the encoder stands still; return its angle, degrees."""
        written, last_deg, still = self._source.write_command(0.0), float("inf"), 0
        for _ in range(convert_seconds_to_blocks(CLOSING_TIMEOUT_S, self._tool)):
            if written.command_v < CLOSING_COMMAND_V:
                written = self._source.write_command(min(written.command_v + RAMP_STEP_V, CLOSING_COMMAND_V))
            block = self.read_block()
            now_deg = float(block.signals["encoder_deg"][-1])
            is_driven = written.command_v == CLOSING_COMMAND_V and not is_before_command(block, written)
            still = still + 1 if is_driven and abs(now_deg - last_deg) < STANDSTILL_DEG else 0
            last_deg = now_deg
            if still >= STANDSTILL_BLOCKS:
                break
        return last_deg

    def settle_at(self, level_v: float) -> RawSignals:
        """Hold the motor command at a level, V; return the signals after the command has settled."""
        written = self._source.write_command(level_v)
        return read_settled(written, self.read_block)


def is_before_command(block: RawBlock, written: AppliedCommand) -> bool:
    """Return whether the whole block was taken before the command took effect; a reader may lag."""
    return block.first_tick + len(block) <= written.latest_tick


def read_settled(written: AppliedCommand, read: Callable[[], RawBlock]) -> RawSignals:
    """Wait until a command has taken effect, skip `SETTLING_BLOCKS`, and return the rest of `LEVEL_BLOCKS`."""
    while is_before_command(block := read(), written):
        pass
    return concatenate_signals([block, *(read() for _ in range(LEVEL_BLOCKS - 1))][SETTLING_BLOCKS:])


def convert_seconds_to_blocks(seconds: float, tool: Tool) -> int:
    return round(seconds * tool.board.sample_rate_hz / tool.board.block_samples)


def concatenate_signals(blocks: list[RawBlock]) -> RawSignals:
    """Return the signals of consecutive raw blocks in one RawSignals."""

    def of(name: str) -> np.ndarray:
        return np.concatenate([block.signals[name] for block in blocks])

    return RawSignals(of("strain_v"), of("motor_command_v"), (of("touch_1_v"), of("touch_2_v")), of("encoder_deg"))


@contextlib.contextmanager
def zero_on_process_death(tool: Tool) -> Iterator[None]:
    """Run a process inside the `with` block that resets the board if this one is killed: the board holds its output."""
    if not tool.has_real_motor:
        yield  # a simulated board ends with the process
        return
    near, far = multiprocessing.Pipe()
    watcher = start_child_process("graspwatch-watcher", _reset_on_broken_pipe, tool, far)
    far.close()
    near.recv()
    try:
        yield
    finally:
        near.send("done")
        watcher.join()


def _reset_on_broken_pipe(tool: Tool, line: Connection) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # they are for the watched process
        signal.signal(number, signal.SIG_IGN)
    read_driver_version(tool)  # connects to the board's server, so that a reset is quick
    line.send("watching")
    try:
        line.recv()
    except EOFError:
        reset_device(tool)
