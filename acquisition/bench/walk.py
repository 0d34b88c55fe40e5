"""Walks a tool from its driver to its jaws; nothing moves before the user agrees."""

import contextlib
import datetime
from collections.abc import Callable, Iterator
from dataclasses import replace

import nidaqmx
import numpy as np

from acquisition.bench import checks
from acquisition.bench.checks import Finding, Outcome
from acquisition.bench.jaws import Jaws, blocks_in, joined, settled_after, zeroed_at_death
from acquisition.nidaq import NidaqTool, check_driver, look_at_board
from config.errors import ToolError
from config.schema import Tool

REST_S = 2.0
LEVELS_V = (0.5, 0.4, 0.3, 0.2, 0.1)

AT_REST = ("sample clock", "strain gage at rest", "motor at zero", "encoder at rest", "touch sensors at rest")
MOVING = ("motor command read back", "round trip", "encoder direction", "encoder scale")
AFTER = "motor at zero afterwards"
ABOUT_CONSTANTS = ("calibration", "force scale")  # they say nothing of the wiring


class Walk:
    """One tool. `options` leads to a simulated board; without it the tool file says how the board is reached.

    `reading` is entered once, while the tool at rest is read: as promptly as it will be read in earnest.
    """

    def __init__(
        self,
        tool: Tool,
        options: nidaqmx.GrpcSessionOptions | None,
        clock: Callable[[], int],
        reading: contextlib.AbstractContextManager[None] | None = None,
    ) -> None:
        self._tool, self._options, self._clock = tool, options, clock
        self._reading = reading or contextlib.nullcontext()

    def findings(self, may_move: Callable[[], bool]) -> Iterator[Finding]:
        """All checks in their order, as they come; `may_move` is asked once the tool at rest is sound."""
        failed = None
        for finding in self._board():
            yield finding
            hinders = finding.outcome is Outcome.FAIL and finding.check not in ABOUT_CONSTANTS
            failed = failed or (finding.check if hinders else None)
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
        yield checks.calibration(self._tool, datetime.date.today())
        yield checks.force_scale(self._tool)

    def _running(self, source: NidaqTool, may_move: Callable[[], bool]) -> Iterator[Finding]:
        tool, failed = self._tool, []
        with self._reading:
            blocks = [source.read_block() for _ in range(blocks_in(REST_S, tool))]
        ticks = np.array([block.first_tick + len(block) for block in blocks])
        rest = joined(blocks)
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
            jaws = Jaws(source, tool, float(rest.strain_v.mean()))
            with zeroed_at_death(tool):
                try:
                    yield from self._moving(source, jaws)
                finally:
                    source.write_command(0.0)
        if "motor at zero" in failed:
            yield from _not_done((AFTER,), "motor at zero")
            return
        after = settled_after(source.write_command(0.0), source.read_block)
        yield replace(checks.command_at_zero(after, tool), check=AFTER)

    def _moving(self, source: NidaqTool, jaws: Jaws) -> Iterator[Finding]:
        """Shut the empty jaws gently, then let them go step by step."""
        tool = self._tool
        begin = jaws.read()
        shut = jaws.shut()
        levels = [jaws.hold(level_v) for level_v in LEVELS_V]
        samples = self._delay(source, jaws)
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

    def _delay(self, source: NidaqTool, jaws: Jaws) -> int:
        """Samples from the write of a command of zero to the first that is read back so."""
        written = source.write_command(0.0)
        for _ in range(blocks_in(0.5, self._tool)):
            block = jaws.read()
            low = np.flatnonzero(block.motor_command_v < LEVELS_V[-1] / 2)
            if len(low):
                break
        return block.first_tick + (int(low[0]) if len(low) else len(block)) - written.earliest


def _not_done(names: tuple[str, ...], failed: str) -> Iterator[Finding]:
    return (Finding(name, Outcome.NOT_DONE, f"mend this first: {failed}") for name in names)
