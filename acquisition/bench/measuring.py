"""Takes the readings that a calibration is fitted to; the board is open only while one is read."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import nidaqmx
import numpy as np

from acquisition.bench import checks
from acquisition.bench.checks import Outcome, Signals
from acquisition.bench.fits import Pass
from acquisition.bench.jaws import MOVE_V, Jaws, blocks_in, joined, zeroed_at_death
from acquisition.contact import COMMAND_ON_V
from acquisition.nidaq import NidaqTool
from acquisition.recordings.playing import Recording
from config.errors import CalibrationError
from config.schema import Tool

TARE_S, WEIGHT_S, REST_S = 10.0, 2.0, 1.0
OPENINGS = 4  # readings at rest, until the jaws stand open
PASSES = 6
LEVELS_V = tuple(np.linspace(0.1, MOVE_V, 9).tolist())
PEAK_SHARES = (0.4, 0.75)
"""Of a grasp's highest strain, between which shut jaws are closed further: 2.0 to 3.1 V on the recordings of 2013. A
tenth more or less at either end moves the stretch by 1 %."""
LEAST_SAMPLES = 8


class Bench:
    """A tool without tissue. `options` leads to a simulated board; its grasper is told by `put` what is done to it."""

    def __init__(
        self, tool: Tool, options: nidaqmx.GrpcSessionOptions | None, clock: Callable[[], int],
        put: Callable[[float, float], None] = lambda pull_n, gauge_m: None,
    ) -> None:  # fmt: skip
        """`put(pull_n, gauge_m)`: the pull on the handle, and the gauge between the jaws, from the next reading on."""
        self._tool, self._options, self._clock, self._put = tool, options, clock, put

    def at_rest(self) -> Signals:
        """The open jaws, for ten seconds.

        Raises:
            ToolError: the board failed.
        """
        return self._still(TARE_S, 0.0)

    def under(self, pull_n: float) -> Signals:
        """The motor at zero, and a weight on the handle.

        Raises:
            ToolError: the board failed.
        """
        return self._still(WEIGHT_S, pull_n)

    def _still(self, seconds: float, pull_n: float) -> Signals:
        self._put(pull_n, 0.0)
        with NidaqTool(self._tool, self._options, self._clock) as source:
            return joined([source.read_block() for _ in range(blocks_in(seconds, self._tool))])

    def shut(self) -> list[Pass]:
        """Empty jaws, shut, with a force that rises and falls in turn.

        Raises:
            ToolError: the board failed, or something is in the jaws; the motor is at zero.
            CalibrationError: the tool is not at rest before, or its encoder does not follow.
        """
        with self._closed_on(0.0) as (jaws, rest_v, _):
            return [self._pass(jaws, rest_v, LEVELS_V[::-1] if n % 2 == 0 else LEVELS_V) for n in range(PASSES)]

    def on_gauge(self, gauge_m: float) -> Pass:
        """Jaws that shut on a gauge; the encoder counts from the open jaws.

        Raises:
            ToolError: the board failed, or the force rose further than it may; the motor is at zero.
            CalibrationError: the tool is not at rest before, or its encoder does not follow.
        """
        with self._closed_on(gauge_m) as (jaws, rest_v, open_deg):
            found = self._pass(jaws, rest_v, LEVELS_V[::-1])
        return Pass(found.strain_v, found.encoder_deg - open_deg)

    @contextmanager
    def _closed_on(self, gauge_m: float) -> Iterator[tuple[Jaws, float, float]]:
        """The jaws shut on something rigid, the strain gage's rest and the encoder with the jaws open."""
        self._put(0.0, gauge_m)
        tool = self._tool
        with NidaqTool(tool, self._options, self._clock) as source:
            for _ in range(OPENINGS):
                rest = joined([source.read_block() for _ in range(blocks_in(REST_S, tool))])
                if checks.encoder_at_rest(rest).outcome is Outcome.PASS:
                    break
            judged = (checks.strain(rest, tool), checks.command_at_zero(rest, tool), checks.encoder_at_rest(rest))
            for finding in judged:
                if finding.outcome is Outcome.FAIL:
                    raise CalibrationError(f"Not begun, {finding.check}: {finding.text}")
            rest_v, open_deg = float(rest.strain_v.mean()), float(rest.encoder_deg.mean())
            jaws = Jaws(source, tool, rest_v)
            with zeroed_at_death(tool):
                try:
                    turned = checks.encoder_direction(jaws.shut() - open_deg, tool)
                    if turned.outcome is Outcome.FAIL:
                        raise CalibrationError(f"Broken off, {turned.check}: {turned.text}")
                    yield jaws, rest_v, open_deg
                finally:
                    source.write_command(0.0)

    def _pass(self, jaws: Jaws, rest_v: float, levels_v: tuple[float, ...]) -> Pass:
        levels = [jaws.hold(level_v) for level_v in levels_v]
        means = [(float(each.strain_v.mean()) - rest_v, float(each.encoder_deg.mean())) for each in levels]
        return Pass(*(np.array(column) for column in zip(*means, strict=True)))


def passes_in(recording: Recording) -> list[Pass]:
    """Each grasp's closing, from where the jaws are shut; rest is what the gage read right before the grasp."""
    tool = recording.tool
    with recording as source:
        signals = joined(list(iter(source.read_block, None)))
    driven = np.concatenate([[False], signals.readback_v > COMMAND_ON_V, [False]])
    begins = np.flatnonzero(~driven[:-1] & driven[1:])
    ends = np.flatnonzero(driven[:-1] & ~driven[1:])
    before = round(0.05 * tool.board.sample_rate_hz)
    found = []
    for begin, end in zip(begins, ends, strict=True):
        rest_v = float(np.median(signals.strain_v[max(begin - before, 0) : begin + 1]))
        strain_v, encoder_deg = signals.strain_v[begin:end] - rest_v, signals.encoder_deg[begin:end]
        if len(strain_v) < before:  # a spike of the command line
            continue
        smooth_v = np.convolve(strain_v, np.full(5, 0.2), "same")
        peak = int(smooth_v.argmax())
        low_v, high_v = (share * smooth_v[peak] for share in PEAK_SHARES)
        below = np.flatnonzero(smooth_v[:peak] < low_v)
        first = int(below[-1]) + 1 if len(below) else 0
        above = np.flatnonzero(smooth_v[first:peak] > high_v)
        last = first + int(above[0]) if len(above) else peak
        if last - first >= LEAST_SAMPLES:
            found.append(Pass(strain_v[first:last], encoder_deg[first:last]))
    return found
