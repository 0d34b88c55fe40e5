"""Takes the readings that a calibration is fitted to; the board is open only while one is read."""

import contextlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

import nidaqmx
import numpy as np

from acquisition.bench import checks
from acquisition.bench.checks import Outcome, Signals
from acquisition.bench.fits import Pass
from acquisition.bench.jaws import MOVE_V, blocks_in, joined, zeroed_at_death
from acquisition.blocks import SampleBlock
from acquisition.contact import COMMAND_ON_V
from acquisition.control import Acquisition, RunEnd
from acquisition.nidaq import NidaqTool
from acquisition.recordings.playing import Recording
from acquisition.safety import Safety
from config.errors import CalibrationError
from config.schema import Conditioning, Custom, Protocol, Tool

TARE_S, WEIGHT_S, REST_S = 10.0, 2.0, 1.0
CLOSE_S, SHUT_S, STEP_S, LEVEL_S, OPEN_S = 0.5, 2.5, 0.01, 0.2, 1.0
SETTLING_S = 0.08
PASSES = 6
LEVELS_V = tuple(np.linspace(0.1, MOVE_V, 9).tolist())
LEVELS_PLAYED = [8, *(level for n in range(PASSES) for level in (range(7, -1, -1) if n % 2 == 0 else range(1, 9)))]
"""In turn, from the highest one down and up again; each an index of `LEVELS_V`."""
PEAK_SHARES = (0.4, 0.75)
"""Of a grasp's highest strain, between which shut jaws are closed further: 2.0 to 3.1 V on the recordings of 2013. A
tenth more or less at either end moves the stretch by 1 %."""
LEAST_SAMPLES = 8


class Bench:
    """A tool without tissue. `options` leads to a simulated board; its grasper is told by `put` what is done to it."""

    def __init__(
        self,
        tool: Tool,
        options: nidaqmx.GrpcSessionOptions | None,
        clock: Callable[[], int],
        put: Callable[[float, float], None] = lambda pull_n, gauge_m: None,
        reading: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext,
    ) -> None:
        """`put(pull_n, gauge_m)`: the pull on the handle, and the gauge between the jaws, from the next reading on.

        Each reading is taken within `reading()`, which may ask the system for priority.
        """
        self._tool, self._options, self._clock, self._put = tool, options, clock, put
        self._reading = reading

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
        with self._reading(), NidaqTool(self._tool, self._options, self._clock) as source:
            return joined([source.read_block() for _ in range(blocks_in(seconds, self._tool))])

    def shut(self) -> list[Pass]:
        """Empty jaws, shut, with a force that rises and falls in turn.

        Raises:
            ToolError: the board failed; the motor is at zero.
            CalibrationError: the tool cannot be armed, failed meanwhile, or its encoder does not follow.
        """
        return self._played(0.0)

    def on_gauge(self, gauge_m: float) -> Pass:
        """The same with a gauge between the jaws, all passes in one.

        Raises:
            ToolError: the board failed; the motor is at zero.
            CalibrationError: the tool cannot be armed, failed meanwhile, or its encoder does not follow.
        """
        return merged(self._played(gauge_m))

    def _played(self, gauge_m: float) -> list[Pass]:
        """`shutting`, armed and watched as any run."""
        self._put(0.0, gauge_m)
        tool, blocks = self._tool, []
        source = NidaqTool(tool, self._options, self._clock)
        acquisition = Acquisition(source, tool, Conditioning())  # takes a while: before samples are due
        with zeroed_at_death(tool), self._reading(), source:
            acquisition.arm()
            while acquisition.safety is Safety.TESTING:
                acquisition.turn()
            if acquisition.safety is not Safety.ARMED:
                raise CalibrationError(f"Not begun: {acquisition.why}.")
            acquisition.start("calibration", shutting(), 1)
            while acquisition.running:
                blocks.append(acquisition.turn())
        [ended] = acquisition.take_ended()
        if ended.end is not RunEnd.FINISHED:
            raise CalibrationError(f"Broken off with the motor at zero: {ended.why}.")
        return passes_played(signals_of(blocks), tool)


def merged(passes: Sequence[Pass]) -> Pass:
    """All readings of several passes."""
    return Pass(*(np.concatenate([getattr(each, name) for each in passes]) for name in Pass.__slots__))


def signals_of(blocks: Sequence[SampleBlock]) -> Signals:
    """The raw signals of consecutive blocks."""
    samples = np.concatenate([block.samples for block in blocks])
    return Signals(
        samples["strain_v"],
        samples["motor_command_v"],
        (samples["touch_1_v"], samples["touch_2_v"]),
        samples["encoder_deg"],
    )


def shutting() -> Protocol:
    """What shuts empty jaws gently, then lets the force on them fall and rise in steps: played like any protocol."""
    time_s, command_v = [0.0], [0.0]
    for n, level_v in enumerate(LEVELS_V[level] for level in LEVELS_PLAYED):
        begin_s = time_s[-1] + (CLOSE_S if n == 0 else STEP_S)
        time_s += [begin_s, begin_s + (SHUT_S if n == 0 else LEVEL_S)]
        command_v += [level_v, level_v]
    wave = Custom(shape="custom", time_s=(*time_s, time_s[-1] + CLOSE_S), command_v=(*command_v, 0.0), rest_s=OPEN_S)
    return Protocol(name="empty_jaws", title="Empty jaws, for a calibration", lead_in_s=REST_S, waveform=wave)


def passes_played(signals: Signals, tool: Tool) -> list[Pass]:
    """Passes of `shutting` as it was played: strain over rest, encoder since the open jaws.

    Raises:
        CalibrationError: it was not played to its end, or the encoder does not follow.
    """
    nearest = np.abs(signals.readback_v[:, None] - np.array(LEVELS_V)).argmin(axis=1)
    held = np.abs(signals.readback_v - np.array(LEVELS_V)[nearest]) < (LEVELS_V[1] - LEVELS_V[0]) / 4
    level = np.where(held, nearest, -1)
    edges = np.flatnonzero(np.diff(level)) + 1
    rate_hz, steps = tool.board.sample_rate_hz, len(LEVELS_V) - 1
    pieces = np.split(np.arange(len(level)), edges)
    pieces = [piece for piece in pieces if level[piece[0]] >= 0 and len(piece) >= LEVEL_S / 2 * rate_hz]
    found = [int(level[piece[0]]) for piece in pieces]
    begin = found.index(steps) if steps in found else 0  # a ramp that was held up on its way counts for nothing
    pieces, found = pieces[begin : begin + PASSES * steps + 1], found[begin : begin + PASSES * steps + 1]
    driven = np.flatnonzero(signals.readback_v > COMMAND_ON_V)
    if found != LEVELS_PLAYED or not len(driven) or driven[0] < rate_hz * REST_S / 2:
        raise CalibrationError("The jaws were not closed and opened as they had to be: repeat, and touch nothing.")
    settled = [piece[round(SETTLING_S * rate_hz) :] for piece in pieces]
    settled[0] = pieces[0][-round(LEVEL_S / 2 * rate_hz) :]
    strain_v = np.array([signals.strain_v[piece].mean() for piece in settled])
    encoder_deg = np.array([signals.encoder_deg[piece].mean() for piece in settled])
    rest_v = float(signals.strain_v[: driven[0]].mean())
    open_deg = float(signals.encoder_deg[: driven[0]].mean())
    turned = checks.encoder_direction(float(encoder_deg[0]) - open_deg, tool)
    if turned.outcome is Outcome.FAIL:
        raise CalibrationError(f"Broken off, {turned.check}: {turned.text}")
    passes = [slice(n * steps, (n + 1) * steps + 1) for n in range(PASSES)]
    return [Pass(strain_v[each] - rest_v, encoder_deg[each] - open_deg) for each in passes]


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
