"""The class NidaqSource, the driver of real and simulated NI boards, and functions that query or reset a board."""

import contextlib
import functools
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import grpc
import nidaqmx
import numpy as np
from nidaqmx.constants import AcquisitionType, EncoderType, TriggerType
from nidaqmx.error_codes import DAQmxErrors
from nidaqmx.errors import DaqError, DaqReadError, RpcError
from nidaqmx.errors import Error as DaqBaseError
from nidaqmx.stream_readers import AnalogMultiChannelReader, CounterReader
from nidaqmx.stream_writers import AnalogSingleChannelWriter
from nidaqmx.system import Device, System

from acquisition.drivers.command_history import AppliedCommand, SampleCountReading
from acquisition.drivers.source import RawBlock
from acquisition.signal_table import SENSOR_SIGNALS, find_analog_inputs
from config.errors import RefusedError, ToolError
from config.network import is_this_computer
from config.schema import Board, Tool

# DaqBaseError covers a missing driver, a failing board and a lost server; OSError a driver that cannot load.
_BOARD_ERRORS = (DaqBaseError, OSError)

READ_TIMEOUT_MARGIN_S = 0.008  # beyond the duration of a block: without samples the force is not known
WATCHING_TIMEOUT_MARGIN_S = 0.25  # without a motor a late sample, as of a board on USB, does no harm
_WRITE_TIMEOUT_S = 1
BUFFER_S = 10.0  # for which the driver keeps readings
RATE_TOLERANCE = 1e-7  # of rounding; a clock's crystal is a hundred times worse
COUNT_INTERVAL_NS, MAX_COUNT_LATENCY_NS, MAX_COUNT_AGE_NS = 100_000_000, 2_000_000, 1_000_000_000
_GRPC_OPTIONS = (("grpc.max_reconnect_backoff_ms", 200), ("grpc.initial_reconnect_backoff_ms", 50))

_IN_USE_TEXT = "Another program uses {device}: close it, then start again."
_ERROR_TEXTS = {
    DAQmxErrors.SAMPLES_NO_LONGER_AVAILABLE: "Samples of {device} were overwritten before this computer fetched them: "
    "close other programs, then start again.",
    DAQmxErrors.SAMPLES_NOT_YET_AVAILABLE: "{device} delivered only {got} of {wanted} samples in time: check that "
    "nothing else uses its sample clock, then start again.",
    DAQmxErrors.INVALID_DEVICE_ID: "There is no board named {device}: connect it, or set `device` under [board] in the "
    "tool file to its name in NI MAX ({detail}).",
    DAQmxErrors.DEV_CANNOT_BE_ACCESSED: "{device} no longer answers: check its seat and power, then start again.",
    DAQmxErrors.PHYSICAL_CHAN_DOES_NOT_EXIST: "{device} lacks a channel that the tool file names under [channels]: "
    "correct it there ({detail}).",
    DAQmxErrors.PAL_RESOURCE_RESERVED: _IN_USE_TEXT,
    DAQmxErrors.RESOURCE_ALREADY_RESERVED: _IN_USE_TEXT,
}


class NidaqSource:
    """A `SampleSource` on one NI board: hardware-clocked inputs, encoder on the same clock, on-demand motor command.

    Instead of the encoder it may have an analog position sensor, and it may have no motor.

    Missing samples are never replaced: a late, short or failed read sets the motor to zero and closes the board, which
    then has to be opened again. Only the first block after `reopen` has `lost_samples`.
    """

    def __init__(
        self,
        tool: Tool,
        grpc_options: nidaqmx.GrpcSessionOptions | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """`grpc_options` leads to a simulated or remote board; without it the installed driver is used.

        `clock` returns the time of a block's read, `t_mono_ns`, ns.
        """
        self._tool = tool
        self._grpc_options = grpc_options
        self._clock = clock
        self._tasks: list[nidaqmx.Task] = []
        self._motor_writer: AnalogSingleChannelWriter | None = None
        self._is_open = False
        self._start_tick = self._next_tick = self._lost_samples = 0
        self._last_read_ns = 0
        self._inputs = find_analog_inputs(tool.channels)
        self._averaged = tool.board.averaged_samples
        self._block_samples = 0
        self.set_block_samples(tool.board.block_samples)

    def set_block_samples(self, samples: int) -> None:
        """Set the number of samples of each block from now on."""
        if samples == self._block_samples:
            return
        self._block_samples, readings = samples, samples * self._averaged
        margin_s = READ_TIMEOUT_MARGIN_S if self._tool.has_motor else WATCHING_TIMEOUT_MARGIN_S
        self._timeout_s = samples / self._tool.board.sample_rate_hz + margin_s
        absent = {each.name for each in SENSOR_SIGNALS} - {*self._inputs, "encoder_deg"}
        self._absent_signals = dict.fromkeys(absent, np.full(samples, np.nan))
        self._analog_v, self._encoder_deg = np.empty((len(self._inputs), readings)), np.empty(readings)

    def __enter__(self) -> Self:
        """Open the board with the motor at zero and the sample clock running.

        Raises:
            ToolError: no driver, no such board or channel, or the board is in use.
        """
        try:
            if self._tool.has_motor:
                self._open_motor()
            encoder = self._open_encoder() if self._tool.channels.encoder else None
            analog = self._open_analog()
            if encoder:
                encoder.start()  # waits for the start of the analog inputs, whose clock it uses
            begin_ns = self._clock()
            analog.start()
            self._sample_count = SampleCountReading(
                self._tool.board.sample_rate_hz, begin_ns, self._clock(), self._start_tick
            )
        except _BOARD_ERRORS as error:
            raise self._close_with_error(error) from error
        except BaseException:
            self._close()
            raise
        self._next_tick, self._is_open = self._start_tick, True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._close():
            raise ToolError(_switch_off_text(self._tool))

    def reopen(self) -> None:
        """Open the board again after this process was held up; ticks continue as if its clock had never stopped.

        Raises:
            ToolError: as on entering.
        """
        self._close()
        self._lost_samples = round((self._clock() - self._last_read_ns) * 1e-9 * self._tool.board.sample_rate_hz)
        self._start_tick = self._next_tick + self._lost_samples
        self.__enter__()

    @property
    def silence_reason(self) -> str:
        """Nothing: samples that do not come are an error."""
        return ""

    def read_block(self) -> RawBlock:
        """Return the next block.

        Raises:
            ToolError: a sample is late or lost, or the board failed; the motor has been commanded to zero.
        """
        self._require_open()
        n, position = self._block_samples * self._averaged, self._tool.channels.position
        try:
            got_v = got_deg = self._analog_reader.read_many_sample(self._analog_v, n, self._timeout_s)
            if position is None:
                got_deg = self._encoder_reader.read_many_sample_double(self._encoder_deg, n, self._timeout_s)
            self._last_read_ns = self._clock()
            self._update_sample_count(self._last_read_ns)
        except _BOARD_ERRORS as error:
            raise self._close_with_error(error) from error
        except BaseException:  # interrupted between the two reads: the next pair would not match
            self._close()
            raise
        if min(got_v, got_deg) < n:
            raise self._close_with_error(
                DaqReadError("short read", DAQmxErrors.SAMPLES_NOT_YET_AVAILABLE, min(got_v, got_deg))
            )
        n = self._block_samples
        analog = dict(zip(self._inputs, self._average(self._analog_v), strict=True))
        encoder_deg = (
            analog["encoder_deg"] * position.degree_per_volt if position else self._average(self._encoder_deg[None])[0]
        )
        block = RawBlock(
            first_tick=self._next_tick,
            t_mono_ns=self._last_read_ns,
            signals={**self._absent_signals, **analog, "encoder_deg": encoder_deg},
            lost_samples=self._lost_samples,
            backlog=max(self._sample_count.min_count_at(self._last_read_ns) - self._next_tick - n, 0),
        )
        self._next_tick, self._lost_samples = self._next_tick + n, 0
        return block

    def _average(self, readings: np.ndarray) -> np.ndarray:
        """Return the means of the readings of each sample, (channels, block_samples)."""
        if self._averaged == 1:
            return readings.copy()
        return readings.reshape(len(readings), self._block_samples, self._averaged).mean(axis=2)

    def _update_sample_count(self, now_ns: int) -> None:
        """Ask the board for its sample count at intervals; while the last answer is fresh, ignore a slow one."""
        age_ns = now_ns - self._sample_count.requested_ns
        if self._next_tick > self._start_tick and age_ns < COUNT_INTERVAL_NS:
            return
        taken = self._start_tick + self._analog_task.in_stream.total_samp_per_chan_acquired // self._averaged
        answered_ns = self._clock()
        if answered_ns - now_ns <= MAX_COUNT_LATENCY_NS or age_ns > MAX_COUNT_AGE_NS:
            self._sample_count = SampleCountReading(self._tool.board.sample_rate_hz, now_ns, answered_ns, taken)

    def write_command(self, command_v: float) -> AppliedCommand:
        """Set the motor command, V, and return between which ticks it takes effect.

        Raises:
            RefusedError: the command is outside the tool's limits or not a number; the motor is at zero.
            ToolError: the board failed.
        """
        most_v = self._tool.limits.max_command_v if self._tool.has_motor else 0.0
        allowed = 0.0 <= command_v <= most_v  # False for NaN, too
        written = self._write_motor(command_v if allowed else 0.0)
        if not allowed:
            if not self._tool.has_motor:
                raise RefusedError(f"The tool {self._tool.name!r} has no motor. Choose the protocol 'by_hand'.")
            raise RefusedError(
                f"{command_v} V is no motor command between 0 and {most_v} V; the motor is at "
                "zero: correct the protocol, or max_command_v under [limits] in the tool file."
            )
        return written

    def _write_motor(self, command_v: float) -> AppliedCommand:
        self._require_open()
        motor, begin_ns = self._motor_writer, self._clock()
        if motor is None:  # the tool has none, and the caller wrote zero
            return AppliedCommand(0.0, self._next_tick, self._next_tick)
        try:
            motor.write_one_sample(command_v, _WRITE_TIMEOUT_S)
        except _BOARD_ERRORS as error:
            raise self._close_with_error(error) from error
        return AppliedCommand(
            command_v, self._sample_count.min_count_at(begin_ns), self._sample_count.max_count_at(self._clock())
        )

    def _require_open(self) -> None:
        if not self._is_open:
            raise ToolError(f"{self._tool.board.device} is not open (any more): open the tool again first.")

    def _open_motor(self) -> None:
        task = self._new_task()
        task.ao_channels.add_ao_voltage_chan(
            self._terminal(self._tool.channels.motor_command), min_val=0.0, max_val=self._tool.limits.max_command_v
        )
        task.start()  # a started task accepts a write without starting and stopping itself each time
        self._motor_writer = AnalogSingleChannelWriter(
            task.out_stream,
            auto_start=False,  # pyright: ignore[reportArgumentType]  nidaqmx declares no type, and its default is a marker
        )
        self._motor_writer.write_one_sample(0.0, _WRITE_TIMEOUT_S)

    def _open_encoder(self) -> nidaqmx.Task:
        task = self._new_task()
        calibration = self._tool.calibration
        task.ci_channels.add_ci_ang_encoder_chan(
            self._terminal(self._tool.channels.encoder),
            decoding_type=EncoderType.X_4,
            # pulses of one turn after the gearbox, so that degrees are those of the geometry's equations
            pulses_per_rev=round(calibration.encoder_counts_per_rev * calibration.encoder_gear_ratio),
        )
        self._configure_sample_clock(task, source="/" + self._terminal("ai/SampleClock"))
        arm = task.triggers.arm_start_trigger
        arm.trig_type = TriggerType.DIGITAL_EDGE
        arm.dig_edge_src = "/" + self._terminal("ai/StartTrigger")
        self._encoder_reader = CounterReader(task.in_stream)
        self._encoder_reader.verify_array_shape = False  # the check would ask the board again at every read
        return task

    def _open_analog(self) -> nidaqmx.Task:
        self._analog_task = task = self._new_task()
        range_v = self._tool.channels.analog_range_v
        for name in self._inputs.values():
            task.ai_channels.add_ai_voltage_chan(self._terminal(name), min_val=-range_v, max_val=range_v)
        self._configure_sample_clock(task, source="")
        self._check_sample_rate(task.timing.samp_clk_rate)
        self._analog_reader = AnalogMultiChannelReader(task.in_stream)
        self._analog_reader.verify_array_shape = False
        return task

    def _new_task(self) -> nidaqmx.Task:
        task = nidaqmx.Task(grpc_options=self._grpc_options)
        self._tasks.append(task)
        return task

    def _configure_sample_clock(self, task: nidaqmx.Task, source: str) -> None:
        rate_hz = self._tool.board.sample_rate_hz * self._averaged
        task.timing.cfg_samp_clk_timing(
            rate_hz, source=source, sample_mode=AcquisitionType.CONTINUOUS, samps_per_chan=round(BUFFER_S * rate_hz)
        )

    def _check_sample_rate(self, made_hz: float) -> None:
        """Refuse a rate that the board cannot make, and which the driver has replaced by the nearest one."""
        board, made_hz = self._tool.board, made_hz / self._averaged
        if abs(made_hz / board.sample_rate_hz - 1.0) > RATE_TOLERANCE:
            self._close()
            times = f" of {self._averaged} readings" if self._averaged > 1 else ""
            raise ToolError(
                f"{board.device} cannot make {board.sample_rate_hz:.10g} samples{times} a second; it would make "
                f"{made_hz:.10g}. Set `sample_rate_hz` under [board] in the tool file to a rate that it can make."
            )

    def _terminal(self, name: str) -> str:
        return f"{self._tool.board.device}/{name}"

    def _close_with_error(self, error: Exception) -> ToolError:
        """Close with the motor at zero; return the error with a text for the user."""
        text, had_motor = _describe_error(error, self._tool), self._motor_writer is not None
        if not self._close():
            return ToolError(f"{text} {_switch_off_text(self._tool)}")
        return ToolError(f"{text} The motor is at zero." if had_motor else text)

    def _close(self) -> bool:
        """Set the motor to zero, then release the board; return False if the motor could not be set to zero."""
        is_zero = self._zero_motor()
        self._motor_writer, self._is_open = None, False
        tasks, self._tasks = self._tasks, []
        for task in tasks:
            # With the motor settled, a task that does not close leaves the board reserved: the next start reports it.
            with contextlib.suppress(*_BOARD_ERRORS):
                task.close()
        return is_zero

    def _zero_motor(self) -> bool:
        if self._motor_writer is None:
            return True
        with contextlib.suppress(*_BOARD_ERRORS):
            self._motor_writer.write_one_sample(0.0, _WRITE_TIMEOUT_S)
            return True
        with contextlib.suppress(ToolError):  # an aborted task accepts no more writes, but a reset sets zero, too
            reset_device(self._tool, self._grpc_options)
            return True
        return False


def create_session_options(tool: Tool) -> nidaqmx.GrpcSessionOptions | None:
    """Return the session options for the server that the tool file names, or None for the installed driver."""
    board = tool.board
    if not board.grpc_address:
        return None
    # a frozen model can be hashed, which the checker does not learn from `model_config`
    channel = _open_grpc_channel(board)  # pyright: ignore[reportArgumentType]
    return nidaqmx.GrpcSessionOptions(channel, "")


@functools.cache
def _open_grpc_channel(board: Board) -> grpc.Channel:
    """Open the channel, once per board, because a reset of the board has no time to connect.

    Raises:
        ToolError: a certificate cannot be read.
    """
    address = board.grpc_address or ""
    direct = is_this_computer(address.rpartition(":")[0])  # the proxy variables are for other computers
    options = (*_GRPC_OPTIONS, ("grpc.enable_http_proxy", int(not direct)))
    if not board.grpc_ca:
        return grpc.insecure_channel(address, options=options)
    ca, key, cert = (_read_pem(path) if path else None for path in (board.grpc_ca, board.grpc_key, board.grpc_cert))
    return grpc.secure_channel(address, grpc.ssl_channel_credentials(ca, key, cert), options=options)


def _read_pem(path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ToolError(
            f"{path}: the certificate or key of the board's server cannot be read ({error.strerror}). Correct its path "
            "under [board] in the tool file."
        ) from None


def reset_device(tool: Tool, grpc_options: nidaqmx.GrpcSessionOptions | None = None) -> None:
    """Abort all tasks on the tool's board and set its outputs to 0 V, after the worker that used it has died.

    Raises:
        ToolError: the board could not be reset; the motor may still be driven.
    """
    try:
        Device(tool.board.device, grpc_options=grpc_options or create_session_options(tool)).reset_device()
    except _BOARD_ERRORS as error:
        raise ToolError(f"{_describe_error(error, tool)} {_switch_off_text(tool)}") from error


def read_driver_version(tool: Tool, grpc_options: nidaqmx.GrpcSessionOptions | None = None) -> str:
    """Return the version of NI's driver, which shows that there is one.

    Raises:
        ToolError: there is no driver.
    """
    try:
        options = grpc_options or create_session_options(tool)
        system = System.remote(options) if options else System.local()
        version = system.driver_version
    except _BOARD_ERRORS as error:
        raise ToolError(_describe_error(error, tool)) from error
    return f"{version.major_version}.{version.minor_version}.{version.update_version}"


@dataclass(frozen=True, slots=True)
class BoardInfo:
    """A board's description of itself; channel names without the device's name."""

    product: str
    analog_inputs: tuple[str, ...]
    analog_outputs: tuple[str, ...]
    counters: tuple[str, ...]
    input_ranges_v: tuple[float, ...]  # upper ends


def read_board_info(tool: Tool, grpc_options: nidaqmx.GrpcSessionOptions | None = None) -> BoardInfo:
    """Return the board's description; nothing is started.

    Raises:
        ToolError: there is no such board, or it does not answer.
    """
    device = Device(tool.board.device, grpc_options=grpc_options or create_session_options(tool))
    try:
        channels = (device.ai_physical_chans, device.ao_physical_chans, device.ci_physical_chans)
        inputs, outputs, counters = (tuple(name.partition("/")[2] for name in each.channel_names) for each in channels)
        return BoardInfo(device.product_type, inputs, outputs, counters, tuple(device.ai_voltage_rngs[1::2]))
    except _BOARD_ERRORS as error:
        raise ToolError(_describe_error(error, tool)) from error


def _describe_error(error: Exception, tool: Tool) -> str:
    """Return a sentence on what happened and what to do next."""
    device = tool.board.device
    if isinstance(error, RpcError):
        trust = ", and that `grpc_ca` is the certificate that vouches for it" if tool.board.grpc_ca else ""
        return f"The server of {device} is lost ({error.description}): see that it runs{trust}, then start again."
    if not isinstance(error, DaqError):
        return (
            "NI-DAQmx, the driver of the board, is missing here or too old: install NI-DAQmx from ni.com, "
            "or run with `--tool simulated`, which needs no driver."
        )
    detail = str(error).partition("\n")[0]
    advice = _ERROR_TEXTS.get(error.error_type, "{device} failed: {detail} Test it in NI MAX, then start again.")
    got = error.samps_per_chan_read if isinstance(error, DaqReadError) else 0
    return advice.format(device=device, detail=detail, got=got, wanted=tool.board.block_samples)


def _switch_off_text(tool: Tool) -> str:
    return f"{tool.board.device} could not be commanded to zero: switch off the motor's amplifier NOW."
