"""Moves jaws that nothing alive is in: gently shut, held at steps of force, let go."""

import contextlib
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection

import numpy as np

from acquisition.bench.checks import Signals
from acquisition.commands import Written
from acquisition.nidaq import NidaqTool, check_driver, reset_device
from acquisition.source import RawBlock
from config.errors import ToolError
from config.schema import Tool, ToolKind

MOVE_V = 0.5
"""0.8 N on the Smart Tool, a third of the lowest injury threshold."""
RISE_V = 0.01  # a block
CLOSING_S = 3.0  # for the jaws to shut
STANDS_BLOCKS, STANDS_DEG = 40, 0.1
LEVEL_BLOCKS, SETTLED_BLOCKS = 40, 16
MOST_STRAIN_V = 0.4
"""Beyond rest: 2 to 3 N, more than the motion comes to."""


class Jaws:
    """The jaws of a tool that is open, and what its strain gage reads at rest."""

    def __init__(self, source: NidaqTool, tool: Tool, rest_v: float) -> None:
        self._source, self._tool, self._rest_v = source, tool, rest_v

    def read(self) -> RawBlock:
        """The next block.

        Raises:
            ToolError: more force than the motion can come to; the motor is at zero.
        """
        block = self._source.read_block()
        strain_v = float(np.median(block.strain_v)) - self._rest_v
        if not abs(strain_v) < MOST_STRAIN_V:
            self._source.write_command(0.0)
            raise ToolError(
                f"The strain gage rose by {strain_v:.2f} V under {MOVE_V} V, more than empty jaws do: the motor is at "
                "zero. Look what is in the jaws, and check gain, sign and cable of the amplifier."
            )
        return block

    def shut(self) -> float:
        """Close until the encoder stands; its angle then, degrees."""
        written, last_deg, still = self._source.write_command(0.0), float("inf"), 0
        for _ in range(blocks_in(CLOSING_S, self._tool)):
            if written.command_v < MOVE_V:
                written = self._source.write_command(min(written.command_v + RISE_V, MOVE_V))
            block = self.read()
            now_deg = float(block.encoder_deg[-1])
            is_driven = written.command_v == MOVE_V and not is_before(block, written)
            still = still + 1 if is_driven and abs(now_deg - last_deg) < STANDS_DEG else 0
            last_deg = now_deg
            if still >= STANDS_BLOCKS:
                break
        return last_deg

    def hold(self, level_v: float) -> Signals:
        """What the sensors read once a level of the command has settled."""
        written = self._source.write_command(level_v)
        return settled_after(written, self.read)


def is_before(block: RawBlock, written: Written) -> bool:
    """Whether all of the block was taken before the command was on: a reader may lag."""
    return block.first_tick + len(block) <= written.latest


def settled_after(written: Written, read: Callable[[], RawBlock]) -> Signals:
    """The next samples that were taken once the command had settled."""
    while is_before(block := read(), written):
        pass
    return joined([block, *(read() for _ in range(LEVEL_BLOCKS - 1))][SETTLED_BLOCKS:])


def blocks_in(seconds: float, tool: Tool) -> int:
    return round(seconds * tool.board.sample_rate_hz / tool.board.block_samples)


def joined(blocks: list[RawBlock]) -> Signals:
    """The signals of consecutive blocks as one stretch."""

    def of(name: str) -> np.ndarray:
        return np.concatenate([getattr(block, name) for block in blocks])

    return Signals(of("strain_v"), of("motor_command_v"), (of("touch_1_v"), of("touch_2_v")), of("encoder_deg"))


@contextlib.contextmanager
def zeroed_at_death(tool: Tool) -> Iterator[None]:
    """Meanwhile a process of its own waits: should this one be killed, it resets the board, which holds its output."""
    if tool.kind is not ToolKind.NIDAQ:
        yield  # a simulated board is gone with the process
        return
    near, far = multiprocessing.Pipe()
    watcher = multiprocessing.get_context("spawn").Process(target=_reset_when_gone, args=(tool, far))
    watcher.start()
    far.close()
    near.recv()
    try:
        yield
    finally:
        near.send("done")
        watcher.join()


def _reset_when_gone(tool: Tool, line: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C is for the one who is watched
    check_driver(tool)  # and with it connect, so that a reset is quick
    line.send("watching")
    try:
        line.recv()
    except EOFError:
        reset_device(tool)
