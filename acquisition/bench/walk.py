"""Walks a tool from its driver to its jaws; nothing moves before the user agrees."""

import contextlib
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from multiprocessing.connection import Connection

import nidaqmx
import numpy as np

from acquisition.bench import checks
from acquisition.bench.checks import Finding, Outcome, Signals
from acquisition.nidaq import NidaqTool, check_driver, look_at_board, reset_device
from acquisition.source import RawBlock
from config.errors import ToolError
from config.schema import Tool, ToolKind

REST_S = 2.0
MOVE_V = 0.5
"""0.8 N on the Smart Tool, a third of the lowest injury threshold."""
RISE_V = 0.01  # a block
CLOSING_S = 3.0  # for the jaws to shut
STANDS_BLOCKS, STANDS_DEG = 40, 0.1
LEVELS_V = (0.5, 0.4, 0.3, 0.2, 0.1)
LEVEL_BLOCKS, SETTLED_BLOCKS = 40, 16
MOST_STRAIN_V = 0.4
"""Beyond rest: 2 to 3 N, more than the motion comes to."""

AT_REST = ("sample clock", "strain gage at rest", "motor at zero", "encoder at rest", "touch sensors at rest")
MOVING = ("motor command read back", "round trip", "encoder direction", "encoder scale")
AFTER = "motor at zero afterwards"


class Walk:
    """One tool. `options` leads to a simulated board; without it the tool file says how the board is reached.

    `reading` is entered once, while the tool at rest is read: as promptly as it will be read in earnest.
    """

    def __init__(
        self, tool: Tool, options: nidaqmx.GrpcSessionOptions | None, clock: Callable[[], int],
        reading: contextlib.AbstractContextManager[None] | None = None,
    ) -> None:  # fmt: skip
        self._tool, self._options, self._clock = tool, options, clock
        self._reading = reading or contextlib.nullcontext()
        self._rest_v = 0.0

    def findings(self, may_move: Callable[[], bool]) -> Iterator[Finding]:
        """All checks in their order, as they come; `may_move` is asked once the tool at rest is sound."""
        failed = None
        for finding in self._board():
            yield finding
            failed = failed or (finding.check if finding.outcome is Outcome.FAIL else None)
        if failed:
            yield from _not_done((*AT_REST, *MOVING, AFTER), failed)
            return
        try:
            with NidaqTool(self._tool, self._options, self._clock) as source:
                yield from self._running(source, may_move)
        except ToolError as error:
            yield Finding("board in use", Outcome.FAIL, str(error))

    def _board(self) -> Iterator[Finding]:
        """What can be known without starting anything."""
        try:
            version = check_driver(self._tool, self._options)
        except ToolError as error:
            yield Finding("driver", Outcome.FAIL, str(error))
            yield from _not_done(("board", "channels"), "driver")
            return
        yield Finding("driver", Outcome.PASS, f"NI-DAQmx {version}")
        try:
            board = look_at_board(self._tool, self._options)
        except ToolError as error:
            yield Finding("board", Outcome.FAIL, str(error))
            yield from _not_done(("channels",), "board")
            return
        yield checks.product(board, self._tool)
        yield checks.channels(board, self._tool)

    def _running(self, source: NidaqTool, may_move: Callable[[], bool]) -> Iterator[Finding]:
        tool, failed = self._tool, []
        with self._reading:
            blocks = [source.read_block() for _ in range(self._blocks_in(REST_S))]
        ticks = np.array([block.first_tick + len(block) for block in blocks])
        rest = _joined(blocks)
        for finding in (
            checks.clock(ticks, np.array([block.t_mono_ns for block in blocks]), tool.board.sample_rate_hz),
            checks.strain(rest, tool),
            checks.command_at_zero(rest, tool),
            checks.encoder_at_rest(rest),
            checks.touch(rest, tool),
        ):
            yield finding
            failed += [finding.check] if finding.outcome is Outcome.FAIL else []
        if failed:
            yield from _not_done(MOVING, failed[0])
        elif not may_move():
            yield from (Finding(each, Outcome.NOT_DONE, "nothing was moved: repeat with --move") for each in MOVING)
        else:
            self._rest_v = float(rest.strain_v.mean())
            with zeroed_at_death(tool):
                try:
                    yield from self._moving(source)
                finally:
                    source.write_command(0.0)
        if "motor at zero" in failed:
            yield from _not_done((AFTER,), "motor at zero")
            return
        after = [source.read_block() for _ in range(LEVEL_BLOCKS)][SETTLED_BLOCKS:]
        yield replace(checks.command_at_zero(_joined(after), tool), check=AFTER)

    def _moving(self, source: NidaqTool) -> Iterator[Finding]:
        """Shut the empty jaws gently, then let them go step by step."""
        tool, levels = self._tool, []
        begin = source.read_block()
        shut = self._shut(source)
        for level_v in LEVELS_V:
            source.write_command(level_v)
            blocks = [self._read(source) for _ in range(LEVEL_BLOCKS)]
            levels.append(_joined(blocks[SETTLED_BLOCKS:]))
        samples = self._delay(source)
        means = [tuple(float(each.mean()) for each in (s.readback_v, s.strain_v, s.encoder_deg)) for s in levels]
        read_v, strain_v, encoder_deg = (np.array(column) for column in zip(*means, strict=True))
        at_zero_v = float(begin.motor_command_v.mean())
        yield checks.readback(np.array([0.0, *LEVELS_V]), np.array([at_zero_v, *read_v]), tool)
        yield checks.round_trip(samples, tool)
        direction = checks.encoder_direction(shut - float(begin.encoder_deg.mean()), tool)
        yield direction
        if direction.outcome is Outcome.PASS:
            yield checks.encoder_scale(strain_v[:-1], encoder_deg[:-1], tool)
        else:
            yield from _not_done(("encoder scale",), direction.check)

    def _shut(self, source: NidaqTool) -> float:
        """Close until the encoder stands; its angle then, degrees."""
        command_v, last_deg, still = 0.0, float("inf"), 0
        for _ in range(self._blocks_in(CLOSING_S)):
            command_v = min(command_v + RISE_V, MOVE_V)
            source.write_command(command_v)
            now_deg = float(self._read(source).encoder_deg[-1])
            still = still + 1 if command_v == MOVE_V and abs(now_deg - last_deg) < STANDS_DEG else 0
            last_deg = now_deg
            if still >= STANDS_BLOCKS:
                break
        return last_deg

    def _delay(self, source: NidaqTool) -> int:
        """Samples between the last one known when the command goes to zero and the first that is read back so."""
        source.write_command(0.0)
        behind = 0
        for _ in range(self._blocks_in(0.5)):
            volts = self._read(source).motor_command_v
            low = np.flatnonzero(volts < LEVELS_V[-1] / 2)
            if len(low):
                return behind + int(low[0])
            behind += len(volts)
        return behind

    def _read(self, source: NidaqTool) -> RawBlock:
        """The next block, of jaws that nothing is in.

        Raises:
            ToolError: more force than the motion can come to.
        """
        block = source.read_block()
        strain_v = float(np.median(block.strain_v)) - self._rest_v
        if not abs(strain_v) < MOST_STRAIN_V:
            source.write_command(0.0)
            raise ToolError(
                f"The strain gage rose by {strain_v:.2f} V under {MOVE_V} V, more than empty jaws do: the motor is at "
                "zero. Look what is in the jaws, and check gain and sign of the amplifier."
            )
        return block

    def _blocks_in(self, seconds: float) -> int:
        return round(seconds * self._tool.board.sample_rate_hz / self._tool.board.block_samples)


def _joined(blocks: list[RawBlock]) -> Signals:
    def of(name: str) -> np.ndarray:
        return np.concatenate([getattr(block, name) for block in blocks])

    return Signals(of("strain_v"), of("motor_command_v"), (of("touch_1_v"), of("touch_2_v")), of("encoder_deg"))


def _not_done(names: tuple[str, ...], failed: str) -> Iterator[Finding]:
    return (Finding(name, Outcome.NOT_DONE, f"mend this first: {failed}") for name in names)


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
