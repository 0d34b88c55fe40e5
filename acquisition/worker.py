"""The acquisition worker: the process that owns the tool, conditions its samples and commands its motor."""

import select
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Self

import zmq

from acquisition import bus
from acquisition.acquisition_loop import AcquisitionController, describe_release
from acquisition.drivers.source import LiveSource
from acquisition.notices import Acquiring, AcquisitionFailed, AcquisitionStalled, GraspReleased, WaitingForSamples
from acquisition.recordings.file_names import is_reference_run
from acquisition.safety.force_limiter import ForceLimiter
from acquisition.safety.safety_monitor import RESET_AFTER_SILENCE_S
from acquisition.safety.server_watchdog import ServerWatchdog
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SampleBlock
from acquisition.tool_factory import open_tool
from acquisition.worker_life import begin_worker
from acquisition.worker_process import ProcessEndFlag, apply_realtime
from config.errors import GraspwatchError, RefusedError, ToolError
from config.schema import (
    ConditioningSettings,
    GraspProtocol,
    LimiterSettings,
    RealtimeSettings,
    TissueLibrary,
    Tool,
    ToolKind,
)

if TYPE_CHECKING:
    from acquisition.simulation.grasper import SimulatedGrasper

REALTIME_PRIORITY = 80
POLL_INTERVAL_MS = 100
PRIORITY_RENEWAL_INTERVAL_S = 1.0
STALL_THRESHOLD_S = 0.5
"""A turn takes 5 or 20 ms, or 30 ms if samples fail to come; a longer turn means that this process was held up."""
ERROR_AFTER_DELAY_S = 1.0
"""An error of the board this soon after a delay is taken for a consequence of the delay."""
REST_BLOCK_S = 0.02
"""Duration of a block while nothing moves. Most of the work is for the block, whatever its length."""
MAX_COMMANDS_PER_BLOCK = 20  # bounds the delay of a stop behind other commands


@dataclass(frozen=True, slots=True)
class AcquisitionSetup:
    """Parameters of the acquisition worker."""

    parent_pid: int
    endpoints: bus.Endpoints
    tool: Tool
    library: TissueLibrary
    conditioning: ConditioningSettings
    tissue: str
    seed: int
    limiter: LimiterSettings
    realtime: RealtimeSettings
    start_signal: Connection  # has a message, which stays in it, once the tool may be opened
    max_server_silence_s: float
    previous_fault: str = ""  # fault that ended the previous worker while the tool was armed

    def with_tool(self, tool: Tool) -> Self:
        return replace(self, tool=tool)


def main(setup: AcquisitionSetup) -> None:
    """Run until a signal or a fault; after an error, publish it and exit with its code."""
    with begin_worker("acquisition", setup.parent_pid, setup.endpoints.samples) as life:
        try:
            _run_acquisition(setup, life.publisher, life.context, life.stop)
        except GraspwatchError as error:
            life.publisher.send_multipart(bus.pack_notice(AcquisitionFailed(str(error))))
            raise SystemExit(error.exit_code) from None


def _run_acquisition(
    setup: AcquisitionSetup, publisher: zmq.Socket, context: zmq.Context, stop: ProcessEndFlag
) -> None:
    """Read the tool until the service ends; between blocks, apply thresholds and execute commands."""
    source, grasper = open_tool(setup.tool, setup.library, setup.tissue, setup.seed)
    limits = bus.open_latest_subscriber(context, setup.endpoints.thresholds)
    signs_of_life = bus.open_latest_subscriber(context, setup.endpoints.server_heartbeat)
    commands = context.socket(zmq.REP)
    commands.bind(setup.endpoints.commands)
    limiter = ForceLimiter(setup.tool, setup.library, setup.limiter) if setup.tool.has_motor else None
    safety = Safety.FAULTED if setup.previous_fault else Safety.DISARMED
    acquisition = AcquisitionController(source, setup.tool, setup.conditioning, limiter, safety, setup.previous_fault)
    server = ServerWatchdog(setup.max_server_silence_s)
    if not wait_until_tool_may_open(setup.start_signal, stop):
        return
    with source:
        granted = apply_realtime(setup.realtime, REALTIME_PRIORITY, core_index=0)
        publisher.send_multipart(bus.pack_notice(Acquiring(str(granted))))
        is_board = setup.tool.kind is not ToolKind.SERIAL
        rest_samples = compute_rest_samples(setup.tool)
        stalls, renewed_s = StallDetector(source, acquisition, publisher, is_board=is_board), time.monotonic()
        while not stop.is_set and (block := stalls.process_block()) is not None:
            if len(block.samples):
                publisher.send_multipart(bus.pack_samples(block))
            else:
                publisher.send_multipart(bus.pack_notice(WaitingForSamples(source.silence_reason)))
            _publish_events(acquisition, publisher)
            if time.monotonic() - renewed_s > PRIORITY_RENEWAL_INTERVAL_S:
                granted.priority.renew()
                renewed_s = time.monotonic()
            if limits.poll(0):
                limit = bus.unpack_threshold(limits.recv())
                acquisition.set_threshold(limit.threshold_n, limit.tick)
            if signs_of_life.poll(0):
                signs_of_life.recv()
                server.on_heartbeat()
            for _ in range(MAX_COMMANDS_PER_BLOCK):
                if not commands.poll(0):
                    break
                command = bus.unpack_command(commands.recv())
                if command is not None:  # an expired one says nothing about the server's present
                    server.on_heartbeat()
                answer = _execute_command(command, acquisition)
                if isinstance(command, bus.StartCommand) and grasper and not answer.refused:
                    _fill_jaws(grasper, command)
                if isinstance(command, bus.SimulatedPullAndGaugeCommand) and grasper:
                    grasper.handle_pull_n, grasper.gauge_m = command.pull_n, command.gauge_m
                commands.send(bus.pack_reply(replace(answer, tick=acquisition.last_tick)))
            if (why := server.check(time.monotonic())) and acquisition.running and setup.tool.has_motor:
                acquisition.fail(why)
            is_told = block.safety is acquisition.safety  # a new state is published in a short block, so without delay
            at_rest = acquisition.at_rest and is_told
            source.set_block_samples(rest_samples if at_rest else setup.tool.board.block_samples)
        if acquisition.running:  # a server that ends in order has stopped the run before
            acquisition.fail("the service was ended from outside during the run")
        acquisition.stop("the service was ended")
        _publish_events(acquisition, publisher)


def compute_rest_samples(tool: Tool) -> int:
    """Return the samples of a block while nothing moves: a multiple of a run's block size."""
    board = tool.board
    return board.block_samples * max(int(REST_BLOCK_S * board.sample_rate_hz / board.block_samples), 1)


def wait_until_tool_may_open(start_signal: Connection, stop: ProcessEndFlag) -> bool:
    """Wait until the tool may be opened. Return False if the service ends before, or has died, which closes the pipe.

    The message stays in the pipe for the next worker.
    """
    waiter = select.poll()
    waiter.register(start_signal.fileno(), select.POLLIN)
    while not stop.is_set:
        for _, events in waiter.poll(POLL_INTERVAL_MS):
            return not events & select.POLLHUP and not stop.is_set
    return False


def _fill_jaws(grasper: "SimulatedGrasper", command: bus.StartCommand) -> None:
    """Put the run's tissue between the simulated jaws, or nothing for a reference grasp."""
    if is_reference_run(command.run_id):
        grasper.gauge_m = 0.0
    elif command.tissue:
        grasper.gauge_m = None
        grasper.set_tissue(command.tissue)


class StallDetector:
    """Reader of blocks that detects when this process was held up: stopped, swapped out or suspended with the machine.

    The board keeps samples for 10 s; the worker reads and publishes them late. After a longer delay, or after a reset
    by the safety monitor, it opens the board again and counts the samples in between as lost. The board's error may
    come some reads after the delay, because a read that was under way is answered first.
    """

    def __init__(
        self,
        source: LiveSource,
        acquisition: AcquisitionController,
        publisher: zmq.Socket,
        clock: Callable[[], float] = time.monotonic,
        *,
        is_board: bool = True,
    ) -> None:
        """With `is_board`, an error soon after a delay means that the board's buffer overflowed: it is opened again."""
        self._is_board = is_board
        self._source, self._acquisition, self._publisher, self._clock = source, acquisition, publisher, clock
        self._last_block_s = clock()
        self._delay_s, self._delay_end_s = 0.0, float("-inf")

    def process_block(self) -> SampleBlock | None:
        """Return the next block.

        Raises:
            ToolError: the board failed, and not because of a stall.
        """
        try:
            block = self._acquisition.process_block()
        except ToolError:
            self._measure_delay()
            if not self._is_board or self._clock() - self._delay_end_s > ERROR_AFTER_DELAY_S:
                raise
            self._delay_end_s = float("-inf")  # another error right after this one is the board's own
            self._source.reopen()
            why = f"{_describe_delay(self._delay_s)}; the board had to be opened again: arm the tool again"
            self._acquisition.restart_after_reopen(why)
            self._publish_stall(why)
            self._last_block_s = self._clock()
            return self.process_block()
        if self._measure_delay() > STALL_THRESHOLD_S:
            self._publish_stall(_describe_delay(self._delay_s))
        return block

    def _measure_delay(self) -> float:
        """Return the seconds since the last block; remember a delay long enough for a reset of the board."""
        before_s, self._last_block_s = self._last_block_s, self._clock()
        delay_s = self._last_block_s - before_s
        if delay_s >= RESET_AFTER_SILENCE_S:
            self._delay_s, self._delay_end_s = delay_s, self._last_block_s
        return delay_s

    def _publish_stall(self, text: str) -> None:
        self._publisher.send_multipart(bus.pack_notice(AcquisitionStalled(text)))


def _describe_delay(delay_s: float) -> str:
    return f"The acquisition was held up for {delay_s:.1f} s"


def _publish_events(acquisition: AcquisitionController, publisher: zmq.Socket) -> None:
    """Publish released grasps and ended runs."""
    for why in acquisition.pop_release_reasons():
        publisher.send_multipart(bus.pack_notice(GraspReleased(describe_release(why))))
    for ended in acquisition.pop_ended_runs():
        publisher.send_multipart(bus.pack_notice(ended))


def _execute_command(command: bus.AnyCommand | None, acquisition: AcquisitionController) -> bus.CommandReply:
    try:
        match command:
            case None:
                return bus.CommandReply(refused="The request came too late and was not obeyed. Try again.")
            case bus.StartCommand():
                protocol = GraspProtocol.model_validate_json(command.protocol)
                acquisition.start(command.run_id, protocol, command.cycles)
            case bus.StopCommand():
                return bus.CommandReply(effect=acquisition.stop(command.why))
            case bus.ArmCommand():
                acquisition.arm(command.unmeasured_scale_reason)
            case bus.DisarmCommand():
                acquisition.disarm()
            case bus.AcknowledgeCommand():
                acquisition.acknowledge()
            case bus.BeginSpotCommand():
                acquisition.begin_spot()
        return bus.CommandReply()
    except RefusedError as error:
        return bus.CommandReply(refused=str(error))
