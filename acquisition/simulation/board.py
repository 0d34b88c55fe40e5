"""The class SimulatedBoard: a PCI-6230 with clock, sample buffers, and outputs that hold. gRPC is in `service.py`."""

import math
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from enum import Enum, auto
from operator import itemgetter
from typing import NamedTuple, Protocol, runtime_checkable

from nidaqmx.error_codes import DAQmxErrors

from acquisition.signal_table import find_wired_inputs
from config.schema import Tool


class Clock(Protocol):
    def now_ns(self) -> int: ...

    def sleep_until_ns(self, wake_ns: float) -> None: ...


class RealClock:
    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until_ns(self, wake_ns: float) -> None:
        while (left_ns := wake_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns * 1e-9)


class VirtualClock:
    """A clock that stands still, and advances exactly as far as its caller sleeps; for one client in this process."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until_ns(self, wake_ns: float) -> None:
        self._now_ns = max(self._now_ns, int(wake_ns))


SensorReadings = dict[str, float]  # V or degrees, by signal


class Plant(Protocol):
    """Simulated hardware at the simulated board: motor, sensors, and what the jaws hold."""

    def step(self, command_v: float) -> SensorReadings:
        """Simulate a sample period under a command, V; return the encoder's angle and the inputs but the read-back."""
        ...


@runtime_checkable
class PlantWithReadback(Protocol):
    """A plant that also determines the read-back of the board's output, V; optional."""

    def readback_v(self, command_v: float) -> float: ...


class BoardError(Exception):
    """A DAQmx call that the board answers with an error code."""

    def __init__(self, code: DAQmxErrors, text: str) -> None:
        super().__init__(text)
        self.code = code


class ChannelKind(Enum):
    ANALOG_IN = auto()
    ENCODER = auto()
    ANALOG_OUT = auto()


class TaskState(Enum):
    STOPPED = auto()
    RUNNING = auto()
    OVERRUN = auto()


# the analog inputs that the tool has, V, in the order of the signal table; encoder, degrees; an input without a wire
Sample = tuple[float, ...]
UNWIRED, UNWIRED_V, POSITION_V = "unwired", 0.0, "position_v"

# A PCI-6230 has these channels, and makes its sample clock by dividing this timebase.
ANALOG_INPUTS = tuple(f"ai{n}" for n in range(8))
ANALOG_OUTPUTS = tuple(f"ao{n}" for n in range(4))
COUNTERS = ("ctr0", "ctr1")
TIMEBASE_HZ = 20e6


class OutputChange(NamedTuple):
    """A change of the motor command output: time, samples since the start, new value."""

    at_ns: int
    sample_index: int
    volts: float


@dataclass(slots=True, eq=False)
class Task:
    """One DAQmx task of the simulated board."""

    name: str
    kind: ChannelKind | None = None
    channels: list[str] = field(default_factory=list)
    column_indices: list[int] = field(default_factory=list)
    rate_hz: float = 0.0
    clock_source: str = ""
    arm_trigger: str = ""
    degrees_per_count: float = 0.0
    output_range_v: tuple[float, float] = (0.0, 0.0)
    drives_motor: bool = False
    state: TaskState = TaskState.STOPPED
    clocked: bool = False
    unread_samples: deque[Sample] = field(default_factory=deque)


class SimulatedBoard:
    """State of the board, safe to call from several threads. Every method raises BoardError as DAQmx would.

    It has the channels of a PCI-6230. The plant is wired to those that the tool names; the others are not connected.

    The plant advances in steps of the sample clock, and only while the clock runs.
    """

    def __init__(self, tool: Tool, plant: Plant, clock: Clock | None = None, buffer_samples: int = 10_000) -> None:
        """`tool` says how the plant is wired; `buffer_samples` defaults to the buffer of DAQmx at 1 kHz, 10 s."""
        self.clock: Clock = clock or RealClock()
        self._plant = plant
        self._compute_readback_v = plant.readback_v if isinstance(plant, PlantWithReadback) else float
        self._device, self.product = tool.board.device, tool.board.product
        self._buffer_samples = buffer_samples
        self._encoder_resolution_deg = tool.calibration.encoder_resolution_deg
        inputs, self._position = find_wired_inputs(tool.channels), tool.channels.position
        if self._position:
            inputs[POSITION_V] = self._position.input
        self._unwired_v = dict.fromkeys((*inputs, UNWIRED), UNWIRED_V)
        self._select_sample = itemgetter(*inputs, "encoder_deg", UNWIRED)
        self._channels = {
            ChannelKind.ANALOG_IN: ANALOG_INPUTS,
            ChannelKind.ENCODER: COUNTERS,
            ChannelKind.ANALOG_OUT: ANALOG_OUTPUTS,
        }
        wired = (*inputs.values(), tool.channels.encoder or None)  # in the order of a Sample
        self._columns = {name: column for column, name in enumerate(wired)}
        self._motor_channel = tool.channels.motor_command or None
        self._analog_clock = f"/{self._device}/ai/SampleClock"
        self._analog_start = f"/{self._device}/ai/StartTrigger"
        self._lock = threading.RLock()
        self._tasks: dict[str, Task] = {}
        self._task_count = 0
        self._output_v = 0.0
        self._clock_task: Task | None = None  # the analog input task, whose clock all tasks use
        self._started_ns = 0
        self._period_ns = 0
        self._sample_count = 0
        self._clock_edges_left: float = math.inf
        self._disconnected_until_ns = self._delayed_until_ns = 0.0
        self._injected_error: BoardError | None = None
        self.output_changes: deque[OutputChange] = deque(maxlen=100_000)

    @property
    def output_v(self) -> float:
        return self._output_v

    # --- life of a task ----------------------------------------------------------------------------------------------

    def create_task(self, name: str) -> str:
        with self._lock:
            self._check_connected()
            self._task_count += 1
            name = name or f"_unnamedTask<{self._task_count}>"
            if name in self._tasks:
                raise BoardError(DAQmxErrors.DUPLICATE_TASK, f"Task {name} exists already.")
            self._tasks[name] = Task(name)
            return name

    def task(self, name: str) -> Task:
        task = self._tasks.get(name)
        if task is None:
            raise BoardError(DAQmxErrors.INVALID_TASK, f"Task {name} does not exist.")
        return task

    def add_channel_to_task(self, name: str, kind: ChannelKind, physical: str) -> Task:
        """Add `physical`, e.g. `Dev1/ai0`, to a task of the simulated board; return the task."""
        device, _, channel = physical.partition("/")
        self.check_device(device)
        if channel not in self._channels[kind]:
            raise BoardError(DAQmxErrors.PHYSICAL_CHAN_DOES_NOT_EXIST, f"Physical channel does not exist: {physical}")
        task = self.task(name)
        task.kind = kind
        task.channels.append(physical)
        task.column_indices.append(self._columns.get(channel, len(self._columns)))
        task.drives_motor = channel == self._motor_channel
        return task

    def channel_names(self, kind: ChannelKind) -> tuple[str, ...]:
        """Return the names of the simulated board's physical channels of a kind, without the device's name."""
        return self._channels[kind]

    def check_device(self, device: str) -> None:
        if device != self._device:
            raise BoardError(
                DAQmxErrors.INVALID_DEVICE_ID,
                f"Device identifier is invalid: {device}; the board here is {self._device}",
            )

    def configure_sample_clock_timing(self, name: str, rate_hz: float, source: str) -> None:
        """Set a task's sample rate and clock source; a rate that the timebase does not give becomes the nearest one."""
        task = self.task(name)
        divisor = max(round(TIMEBASE_HZ / rate_hz), 1)
        task.rate_hz, task.clock_source = TIMEBASE_HZ / divisor, source

    def start_task(self, name: str) -> None:
        with self._lock:
            task = self.task(name)
            if task.kind is None:
                raise BoardError(DAQmxErrors.CAN_NOT_PERFORM_OP_WHEN_NO_CHANS_IN_TASK, f"Task {name} has no channels.")
            if any(other.kind is task.kind and other.state is TaskState.RUNNING for other in self._tasks.values()):
                raise BoardError(DAQmxErrors.PAL_RESOURCE_RESERVED, "The specified resource is reserved.")
            self._simulate_until_now()
            task.unread_samples.clear()
            task.state = TaskState.RUNNING
            if task.kind is ChannelKind.ANALOG_IN:
                self._start_sample_clock(task)
            else:
                # without the analog clock it is never sampled; a start trigger that has passed does not come again
                task.clocked = task.clock_source == self._analog_clock and not task.arm_trigger

    def stop_task(self, name: str) -> None:
        with self._lock:
            self._simulate_until_now()
            task = self.task(name)
            task.state = TaskState.STOPPED
            task.clocked = False

    def clear_task(self, name: str) -> None:
        with self._lock:
            self.stop_task(name)
            del self._tasks[name]

    def reset_device(self, device: str) -> None:
        """Abort all simulated tasks and set the output to 0 V."""
        self.check_device(device)
        with self._lock:
            self._check_connected()
            self._simulate_until_now()
            for task in self._tasks.values():
                task.state = TaskState.STOPPED
            self._set_output(0.0)
            self._clock_edges_left = math.inf

    def _set_output(self, volts: float) -> None:
        if volts != self._output_v:
            self._output_v = volts
            self.output_changes.append(OutputChange(self.clock.now_ns(), self._sample_count, volts))

    # --- faults ------------------------------------------------------------------------------------------------------

    def stop_sample_clock(self, after: int) -> None:
        """Simulate a fault: the sample clock stops `after` samples from now, until the device is reset."""
        with self._lock:
            self._simulate_until_now()
            self._clock_edges_left = after

    def disconnect(self, duration_s: float) -> None:
        """Simulate a fault: for a while, s, the board delivers no samples, and calls to it fail."""
        with self._lock:
            self._simulate_until_now()
            self._disconnected_until_ns = self.clock.now_ns() + duration_s * 1e9

    def withhold_samples(self, duration_s: float) -> None:
        """Simulate a fault: for a while, s, the board takes samples but delivers none."""
        with self._lock:
            self._delayed_until_ns = self.clock.now_ns() + duration_s * 1e9

    def fail_next_read(self, code: DAQmxErrors) -> None:
        """Simulate a fault: only the next read fails, with this error code."""
        with self._lock:
            self._injected_error = BoardError(code, f"failed with {int(code)}")

    @property
    def _is_disconnected(self) -> bool:
        return self.clock.now_ns() < self._disconnected_until_ns

    def _check_connected(self) -> None:
        if self._is_disconnected:
            raise BoardError(DAQmxErrors.DEV_CANNOT_BE_ACCESSED, f"{self._device} cannot be accessed.")

    # --- samples -----------------------------------------------------------------------------------------------------

    def write_output(self, name: str, volts: float, auto_start: bool) -> None:
        with self._lock:
            task = self.task(name)
            if task.state is not TaskState.RUNNING and not auto_start:
                code = DAQmxErrors.CANNOT_WRITE_WHEN_AUTO_START_FALSE_AND_TASK_NOT_RUNNING
                raise BoardError(code, f"Task {name} is not running.")
            self._check_connected()
            low_v, high_v = task.output_range_v
            if not low_v <= volts <= high_v:
                raise BoardError(DAQmxErrors.INVALID_AO_DATA_WRITE, f"{volts} V is outside {low_v} to {high_v} V.")
            self._simulate_until_now()  # the old value held until now
            if task.drives_motor:
                self._set_output(volts)

    def read_analog(self, name: str, count: int, timeout_s: float) -> tuple[list[float], int]:
        """Return up to `count` samples per channel, channel after channel, and their number; fewer after a time-out."""
        samples = self._read(name, count, timeout_s)
        return [sample[column] for column in self.task(name).column_indices for sample in samples], len(samples)

    def count_acquired_samples(self, name: str) -> int:
        """Return the number of samples taken since the start of the clock, read or not."""
        with self._lock:
            self._check_connected()
            self._simulate_until_now()
            self._require_running(name)
            return self._sample_count

    def read_encoder(self, name: str, count: int, timeout_s: float) -> tuple[list[float], int]:
        """Return up to `count` samples in degrees, by the task's own scale of the counts, and their number."""
        samples = self._read(name, count, timeout_s)
        scale, resolution_deg = self.task(name).degrees_per_count, self._encoder_resolution_deg
        [column] = self.task(name).column_indices
        return [round(sample[column] / resolution_deg) * scale for sample in samples], len(samples)

    def _read(self, name: str, count: int, timeout_s: float) -> list[Sample]:
        with self._lock:
            self._simulate_until_now()
            task = self._require_running(name)
            if self._injected_error:
                error, self._injected_error = self._injected_error, None
                raise error
            wake_ns = min(self._ready_ns(task, count), self.clock.now_ns() + round(timeout_s * 1e9))
        self.clock.sleep_until_ns(wake_ns)  # without the lock: a real board accepts an output while a read waits
        with self._lock:
            self._simulate_until_now()
            samples = self._require_running(name).unread_samples
            if self._is_disconnected or self.clock.now_ns() < self._delayed_until_ns:
                return []  # a time-out without a sample
            return [samples.popleft() for _ in range(min(count, len(samples)))]

    def _require_running(self, name: str) -> Task:
        task = self.task(name)
        if task.state is TaskState.OVERRUN:
            raise BoardError(DAQmxErrors.SAMPLES_NO_LONGER_AVAILABLE, "The samples are no longer available.")
        if task.state is not TaskState.RUNNING:
            raise BoardError(DAQmxErrors.OPERATION_ABORTED, f"{name} was stopped or aborted.")
        return task

    def _ready_ns(self, task: Task, count: int) -> float:
        """Return when the task will hold `count` samples; infinite if its clock does not run."""
        missing = count - len(task.unread_samples)
        if (silent_until_ns := max(self._disconnected_until_ns, self._delayed_until_ns)) > self.clock.now_ns():
            return silent_until_ns
        if missing <= 0:
            return self.clock.now_ns()
        if not (self._is_clock_running and task.clocked) or missing > self._clock_edges_left:
            return math.inf
        return self._started_ns + (self._sample_count + missing) * self._period_ns

    @property
    def _is_clock_running(self) -> bool:
        return self._clock_task is not None and self._clock_task.state is TaskState.RUNNING

    def _start_sample_clock(self, task: Task) -> None:
        self._clock_task = task
        self._started_ns = self.clock.now_ns()
        self._period_ns = round(1e9 / task.rate_hz)
        self._sample_count = 0
        task.clocked = True
        for other in self._tasks.values():
            if other.state is TaskState.RUNNING and other.clock_source == self._analog_clock:
                other.clocked = other.arm_trigger in ("", self._analog_start)

    def _simulate_until_now(self) -> None:
        """Advance the plant to the present time, sample by sample, under the output held meanwhile."""
        if not self._is_clock_running:
            return
        due = (self.clock.now_ns() - self._started_ns) // self._period_ns - self._sample_count
        due = int(min(due, self._clock_edges_left))
        if due <= 0:
            return
        self._sample_count += due
        self._clock_edges_left -= due
        clocked = [task for task in self._tasks.values() if task.clocked and task.state is TaskState.RUNNING]
        queues = [task.unread_samples for task in clocked]
        step, command_v = self._plant.step, self._output_v
        inputs_v = self._unwired_v | {"motor_command_v": self._compute_readback_v(command_v)}
        for _ in range(min(due, self._buffer_samples + 1)):  # samples after an overrun cannot be read
            readings = inputs_v | step(command_v)
            if self._position:
                readings[POSITION_V] = readings["encoder_deg"] / self._position.degree_per_volt
            sample = self._select_sample(readings)
            for queue in queues:
                queue.append(sample)
        for task in clocked:
            if len(task.unread_samples) > self._buffer_samples:
                task.state = TaskState.OVERRUN
