"""The class CalibrationBench, which takes the readings of calibrations, and functions on samples of such readings.

The bench opens the board for a reading and closes it afterwards.
"""

import contextlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

import nidaqmx
import numpy as np

from acquisition.acquisition_loop import AcquisitionController
from acquisition.bench import checks
from acquisition.bench.checks import CheckOutcome, RawSignals
from acquisition.bench.fits import ForcePass
from acquisition.bench.jaw_motion import (
    CLOSING_COMMAND_V,
    concatenate_signals,
    convert_seconds_to_blocks,
    zero_on_process_death,
)
from acquisition.drivers.nidaq import NidaqSource
from acquisition.notices import RunOutcome
from acquisition.recordings.recording import RecordingSource
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock
from acquisition.signals.calibration import compute_sensor_signals_from_jaws
from acquisition.signals.grasp_tracker import COMMAND_ON_V
from config.errors import CalibrationError
from config.schema import ConditioningSettings, CustomWaveform, GraspProtocol, Tool

TARE_S, WEIGHT_S, REST_S = 10.0, 2.0, 1.0
CLOSE_S, CLOSED_S, STEP_S, LEVEL_S, OPEN_S = 0.5, 2.5, 0.01, 0.2, 1.0
SETTLING_S = 0.08
PASS_COUNT = 6
LEVELS_V = tuple(np.linspace(0.1, CLOSING_COMMAND_V, 9).tolist())
LEVEL_SEQUENCE = [8, *(level for n in range(PASS_COUNT) for level in (range(7, -1, -1) if n % 2 == 0 else range(1, 9)))]
"""Indices of `LEVELS_V`, from the highest down and up again."""
PEAK_SHARES = (0.4, 0.75)
"""Shares of a grasp's highest strain between which shut jaws close further: 2.0 to 3.1 V on the recordings of 2013. A
tenth more or less at either end changes the stretch by 1 %.
"""
MIN_PASS_SAMPLES = 8


class CalibrationBench:
    """A tool without tissue, from which readings are taken.

    `options` connects to a simulated board; `set_load` then puts the load on its grasper.
    """

    def __init__(
        self,
        tool: Tool,
        options: nidaqmx.GrpcSessionOptions | None,
        clock: Callable[[], int],
        set_load: Callable[[float, float], None] = lambda pull_n, gauge_m: None,
        reading_context: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext,
    ) -> None:
        """`set_load(pull_n, gauge_m)` sets pull on the handle and gauge between the jaws, from the next reading on.

        Each reading is taken within `reading_context()`, which may ask the system for priority.
        """
        self._tool, self._options, self._clock, self._set_load = tool, options, clock, set_load
        self._reading_context = reading_context

    def read_at_rest(self) -> RawSignals:
        """Read the open jaws for ten seconds; return the raw signals.

        Raises:
            ToolError: the board failed.
        """
        return self._read_still(TARE_S, 0.0)

    def read_under_pull(self, pull_n: float) -> RawSignals:
        """Read with the motor at zero and a weight on the handle, N; return the raw signals.

        Raises:
            ToolError: the board failed.
        """
        return self._read_still(WEIGHT_S, pull_n)

    def read_under_jaw_force(self, force_n: float) -> RawSignals:
        """Read with the motor at zero and a load cell between the jaws; return the raw signals.

        The handle of a simulated tool is pulled so that the force between the jaws is `force_n`, N.

        Raises:
            ToolError: the board failed.
        """
        return self._read_still(WEIGHT_S, compute_handle_pull(self._tool, force_n))

    def _read_still(self, seconds: float, pull_n: float) -> RawSignals:
        self._set_load(pull_n, 0.0)
        with self._reading_context(), NidaqSource(self._tool, self._options, self._clock) as source:
            return concatenate_signals(
                [source.read_block() for _ in range(convert_seconds_to_blocks(seconds, self._tool))]
            )

    def sweep_force_on_empty_jaws(self) -> list[ForcePass]:
        """Shut the empty jaws, let the force fall and rise in turn, and return one pass for each direction.

        Raises:
            ToolError: the board failed; the motor is at zero.
            CalibrationError: the tool cannot be armed, failed meanwhile, or its encoder does not follow.
        """
        return self._play_passes(0.0)

    def sweep_force_on_gauge(self, gauge_m: float) -> ForcePass:
        """Shut the jaws on a gauge of `gauge_m`, let the force fall and rise, and return all readings as one pass.

        Raises:
            ToolError: the board failed; the motor is at zero.
            CalibrationError: the tool cannot be armed, failed meanwhile, or its encoder does not follow.
        """
        return merge_passes(self._play_passes(gauge_m))

    def _play_passes(self, gauge_m: float) -> list[ForcePass]:
        """Play the closing protocol, armed and monitored as any run."""
        self._set_load(0.0, gauge_m)
        tool, blocks = self._tool, []
        source = NidaqSource(tool, self._options, self._clock)
        # Takes a while, so before samples are due.
        acquisition = AcquisitionController(source, tool, ConditioningSettings())
        with zero_on_process_death(tool), self._reading_context(), source:
            acquisition.arm()
            while acquisition.safety is Safety.TESTING:
                acquisition.process_block()
            if acquisition.safety is not Safety.ARMED:
                raise CalibrationError(f"Not begun: {acquisition.why}.")
            acquisition.start("calibration", build_closing_protocol(), 1)
            while acquisition.running:
                blocks.append(acquisition.process_block())
        [ended] = acquisition.pop_ended_runs()
        if ended.end is not RunOutcome.FINISHED:
            raise CalibrationError(f"Broken off with the motor at zero: {ended.why}.")
        return extract_force_passes(extract_signals(blocks), tool)


def compute_handle_pull(tool: Tool, jaw_force_n: float) -> float:
    """Return the pull on the handle, N, for a force between the open jaws."""
    strain_v, _ = compute_sensor_signals_from_jaws(tool, jaw_force_n, 0.0)
    return strain_v * tool.calibration.newton_per_volt


def merge_passes(passes: Sequence[ForcePass]) -> ForcePass:
    """Return all readings of several passes as one."""
    return ForcePass(*(np.concatenate([getattr(each, name) for each in passes]) for name in ForcePass.__slots__))


def extract_signals(blocks: Sequence[SampleBlock]) -> RawSignals:
    """Return the raw signals of consecutive blocks."""
    return select_raw_signals(np.concatenate([block.samples for block in blocks], dtype=SAMPLE_DTYPE))


def select_raw_signals(samples: np.ndarray) -> RawSignals:
    """Return the raw signals of samples of dtype SAMPLE_DTYPE."""
    return RawSignals(
        samples["strain_v"],
        samples["motor_command_v"],
        (samples["touch_1_v"], samples["touch_2_v"]),
        samples["encoder_deg"],
    )


def build_closing_protocol() -> GraspProtocol:
    """Return the protocol that shuts empty jaws gently, then lets the force on them fall and rise in steps."""
    time_s, command_v = [0.0], [0.0]
    for n, level_v in enumerate(LEVELS_V[level] for level in LEVEL_SEQUENCE):
        begin_s = time_s[-1] + (CLOSE_S if n == 0 else STEP_S)
        time_s += [begin_s, begin_s + (CLOSED_S if n == 0 else LEVEL_S)]
        command_v += [level_v, level_v]
    wave = CustomWaveform(
        shape="custom", time_s=(*time_s, time_s[-1] + CLOSE_S), command_v=(*command_v, 0.0), rest_s=OPEN_S
    )
    return GraspProtocol(name="empty_jaws", title="Empty jaws, for a calibration", lead_in_s=REST_S, waveform=wave)


def extract_force_passes(signals: RawSignals, tool: Tool) -> list[ForcePass]:
    """Return the passes of a played closing protocol, one a direction: strain over rest, encoder since open jaws.

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
    begin = found.index(steps) if steps in found else 0  # drops an interrupted first ramp
    pieces, found = pieces[begin : begin + PASS_COUNT * steps + 1], found[begin : begin + PASS_COUNT * steps + 1]
    driven = np.flatnonzero(signals.readback_v > COMMAND_ON_V)
    if found != LEVEL_SEQUENCE or not len(driven) or driven[0] < rate_hz * REST_S / 2:
        raise CalibrationError("The jaws were not closed and opened as they had to be: repeat, and touch nothing.")
    settled = [piece[round(SETTLING_S * rate_hz) :] for piece in pieces]
    settled[0] = pieces[0][-round(LEVEL_S / 2 * rate_hz) :]
    strain_v = np.array([signals.strain_v[piece].mean() for piece in settled])
    encoder_deg = np.array([signals.encoder_deg[piece].mean() for piece in settled])
    rest_v = float(signals.strain_v[: driven[0]].mean())
    open_deg = float(signals.encoder_deg[: driven[0]].mean())
    turned = checks.check_encoder_direction(float(encoder_deg[0]) - open_deg, tool)
    if turned.outcome is CheckOutcome.FAIL:
        raise CalibrationError(f"Broken off, {turned.check}: {turned.text}")
    passes = [slice(n * steps, (n + 1) * steps + 1) for n in range(PASS_COUNT)]
    return [ForcePass(strain_v[each] - rest_v, encoder_deg[each] - open_deg) for each in passes]


def extract_recorded_force_passes(recording: RecordingSource) -> list[ForcePass]:
    """Return one pass for each grasp of a recording: its closing once the jaws are shut.

    Strain counts over the gage's reading right before the grasp.
    """
    with recording as source:
        signals = concatenate_signals(list(iter(source.read_block, None)))
    return extract_grasp_passes(signals, recording.tool)


def extract_grasp_passes(signals: RawSignals, tool: Tool) -> list[ForcePass]:
    """Return the closing with shut jaws of each grasp in these signals, as `extract_recorded_force_passes` does."""
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
        if last - first >= MIN_PASS_SAMPLES:
            found.append(ForcePass(strain_v[first:last], encoder_deg[first:last]))
    return found
