"""The class HardwareCheck: checks of a tool from its driver to its jaws, which move only once the user agrees."""

import contextlib
import datetime
from collections.abc import Callable, Iterator
from dataclasses import replace

import nidaqmx
import numpy as np

from acquisition.bench import checks
from acquisition.bench.checks import CheckOutcome, CheckResult
from acquisition.bench.jaw_motion import (
    EmptyJaws,
    concatenate_signals,
    convert_seconds_to_blocks,
    read_settled,
    zero_on_process_death,
)
from acquisition.drivers.nidaq import NidaqSource, read_board_info, read_driver_version
from config.errors import ToolError
from config.schema import Tool

REST_S = 2.0
LEVELS_V = (0.5, 0.4, 0.3, 0.2, 0.1)

AT_REST_CHECKS = ("sample clock", "strain gage at rest", "motor at zero", "encoder at rest", "touch sensors at rest")
MOVING_CHECKS = ("motor command read back", "round trip", "encoder direction", "encoder scale")
ZERO_AFTERWARDS_CHECK = "motor at zero afterwards"
NO_MOTOR_RESULT = CheckResult("motor at zero", CheckOutcome.NOT_DONE, "the tool has no motor")
CONSTANT_CHECKS = ("calibration", "force scale")  # these do not concern the wiring


class HardwareCheck:
    """Checks of one tool. `options` leads to a simulated board; without it the tool file names the board.

    `reading_context` is entered once, for the reading at rest, so that blocks come as promptly as in a run.
    """

    def __init__(
        self,
        tool: Tool,
        options: nidaqmx.GrpcSessionOptions | None,
        clock: Callable[[], int],
        reading_context: contextlib.AbstractContextManager[None] | None = None,
    ) -> None:
        self._tool, self._options, self._clock = tool, options, clock
        self._reading_context = reading_context or contextlib.nullcontext()

    def run_checks(self, may_move: Callable[[], bool]) -> Iterator[CheckResult]:
        """Yield the results of all checks in order; ask `may_move()` once the tool at rest is sound."""
        failed = None
        for finding in self._check_board():
            yield finding
            hinders = finding.outcome is CheckOutcome.FAIL and finding.check not in CONSTANT_CHECKS
            failed = failed or (finding.check if hinders else None)
        if failed:
            yield from _skip_checks((*AT_REST_CHECKS, *MOVING_CHECKS, ZERO_AFTERWARDS_CHECK), failed)
            return
        try:
            with NidaqSource(self._tool, self._options, self._clock) as source:
                yield from self._check_open_board(source, may_move)
        except ToolError as error:
            yield CheckResult("board in use", CheckOutcome.FAIL, str(error))

    def _check_board(self) -> Iterator[CheckResult]:
        """Yield the results of the checks that start nothing."""
        try:
            version = read_driver_version(self._tool, self._options)
        except ToolError as error:
            yield CheckResult("driver", CheckOutcome.FAIL, str(error))
            yield from _skip_checks(("board", "channels"), "driver")
            return
        yield CheckResult("driver", CheckOutcome.PASS, f"NI-DAQmx {version}")
        try:
            board = read_board_info(self._tool, self._options)
        except ToolError as error:
            yield CheckResult("board", CheckOutcome.FAIL, str(error))
            yield from _skip_checks(("channels",), "board")
            return
        yield checks.check_product(board, self._tool)
        yield checks.check_channels_exist(board, self._tool)
        yield checks.check_calibration(self._tool, datetime.date.today())
        yield checks.check_force_scale(self._tool)

    def _check_open_board(self, source: NidaqSource, may_move: Callable[[], bool]) -> Iterator[CheckResult]:
        tool, failed = self._tool, []
        with self._reading_context:
            blocks = [source.read_block() for _ in range(convert_seconds_to_blocks(REST_S, tool))]
        ticks = np.array([block.first_tick + len(block) for block in blocks])
        rest = concatenate_signals(blocks)
        for finding in (
            checks.check_sample_clock(
                ticks, np.array([block.t_mono_ns for block in blocks]), tool.board.sample_rate_hz
            ),
            checks.check_strain(rest, tool),
            checks.check_command_at_zero(rest, tool) if tool.has_motor else NO_MOTOR_RESULT,
            checks.check_encoder_at_rest(rest),
            checks.check_touch_sensors(rest, tool),
        ):
            yield finding
            failed += [finding.check] if finding.outcome is CheckOutcome.FAIL else []
        if not tool.has_motor:
            for each in (*MOVING_CHECKS, ZERO_AFTERWARDS_CHECK):
                yield replace(NO_MOTOR_RESULT, check=each)
            return
        if failed:
            yield from _skip_checks(MOVING_CHECKS, failed[0])
        elif not may_move():
            yield from (
                CheckResult(each, CheckOutcome.NOT_DONE, "nothing was moved: repeat with --move")
                for each in MOVING_CHECKS
            )
        else:
            jaws = EmptyJaws(source, tool, float(rest.strain_v.mean()))
            with zero_on_process_death(tool):
                try:
                    yield from self._check_moving(source, jaws)
                finally:
                    source.write_command(0.0)
        if "motor at zero" in failed:
            yield from _skip_checks((ZERO_AFTERWARDS_CHECK,), "motor at zero")
            return
        after = read_settled(source.write_command(0.0), source.read_block)
        yield replace(checks.check_command_at_zero(after, tool), check=ZERO_AFTERWARDS_CHECK)

    def _check_moving(self, source: NidaqSource, jaws: EmptyJaws) -> Iterator[CheckResult]:
        """Shut the empty jaws gently, then release them step by step."""
        tool = self._tool
        begin = jaws.read_block()
        shut = jaws.close()
        levels = [jaws.settle_at(level_v) for level_v in LEVELS_V]
        samples = self._measure_round_trip(source, jaws)
        means = [tuple(float(each.mean()) for each in (s.readback_v, s.strain_v, s.encoder_deg)) for s in levels]
        read_v, strain_v, encoder_deg = (np.array(column) for column in zip(*means, strict=True))
        at_zero_v = float(begin.signals["motor_command_v"].mean())
        yield checks.check_readback(np.array([0.0, *LEVELS_V]), np.array([at_zero_v, *read_v]), tool)
        yield checks.check_round_trip(samples, tool)
        direction = checks.check_encoder_direction(shut - float(begin.signals["encoder_deg"].mean()), tool)
        yield direction
        if direction.outcome is CheckOutcome.PASS:
            yield checks.check_cable_stretch(strain_v[:-1], encoder_deg[:-1], tool)
        else:
            yield from _skip_checks(("encoder scale",), direction.check)

    def _measure_round_trip(self, source: NidaqSource, jaws: EmptyJaws) -> int:
        """Return the samples from the write of a zero command to its first read-back."""
        written = source.write_command(0.0)
        seen_tick = written.earliest_tick
        for _ in range(convert_seconds_to_blocks(0.5, self._tool)):
            block = jaws.read_block()
            low = np.flatnonzero(block.signals["motor_command_v"] < LEVELS_V[-1] / 2)
            seen_tick = block.first_tick + (int(low[0]) if len(low) else len(block))
            if len(low):
                break
        return seen_tick - written.earliest_tick


def _skip_checks(names: tuple[str, ...], failed: str) -> Iterator[CheckResult]:
    return (CheckResult(name, CheckOutcome.NOT_DONE, f"mend this first: {failed}") for name in names)
