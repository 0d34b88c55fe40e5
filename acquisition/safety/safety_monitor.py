"""The safety monitor: a separate process that brings the motor to zero when the acquisition falls silent in a run.

A board holds its last output when the process that wrote it hangs, is stopped or dies. The safety monitor depends on no
other process: it receives the published blocks, and resets the device when they stop. It repeats a failed reset. Asked
to end, it stays until the motor is known to be at zero.
"""

import time
from dataclasses import dataclass

import zmq

from acquisition import bus
from acquisition.drivers.nidaq import read_driver_version, reset_device
from acquisition.notices import Monitoring, MotorNotZeroed, MotorZeroed, RunEnded
from acquisition.safety_state_machine import RUN_STATES
from acquisition.worker_life import begin_worker
from acquisition.worker_process import apply_realtime
from config.errors import ToolError
from config.schema import RealtimeSettings, Tool

REALTIME_PRIORITY = 70
"""Lower than the acquisition's, so that a safety monitor that runs wild does not delay it."""
POLL_INTERVAL_MS = 10
SILENT_POLLS = 6
"""Consecutive polls without a block, 60 to 70 ms. Polls count, not time: a delayed safety monitor saw nothing."""
RESET_AFTER_SILENCE_S = SILENT_POLLS * POLL_INTERVAL_MS / 1e3
REPORT_INTERVAL_S = 0.1
RETRY_POLLS = 5  # after a reset that failed
CPU_BURST_US = 100_000
"""The safety monitor only waits: one that computes for so long runs wild, and an alarm is due within 0.5 s."""


@dataclass(frozen=True, slots=True)
class SafetyMonitorSetup:
    """Parameters of the safety monitor."""

    parent_pid: int
    endpoints: bus.Endpoints
    tool: Tool
    realtime: RealtimeSettings


def main(setup: SafetyMonitorSetup) -> None:
    """Run until a signal, or beyond it until a run under way has ended."""
    with begin_worker("guard", setup.parent_pid, setup.endpoints.safety_monitor) as life:
        blocks = bus.open_subscriber(life.context, setup.endpoints.samples)
        read_driver_version(setup.tool)  # connects to the board's server, so that a reset is quick
        granted = apply_realtime(setup.realtime, REALTIME_PRIORITY, core_index=1, cpu_burst_us=CPU_BURST_US)
        in_run, silent, said_s = False, 0, 0.0
        while in_run or not life.stop.is_set:
            if time.monotonic() - said_s > REPORT_INTERVAL_S:
                said_s = time.monotonic()
                granted.priority.renew()
                life.publisher.send_multipart(bus.pack_notice(Monitoring(str(granted))))
            if blocks.poll(POLL_INTERVAL_MS):
                parts = blocks.recv_multipart()
                if parts[0] == bus.SAMPLES_TOPIC:
                    in_run, silent = bus.unpack_safety(parts) in RUN_STATES, 0
                elif isinstance(bus.unpack_notice(parts), RunEnded):
                    in_run = False
            elif in_run:
                silent += 1
                if silent >= SILENT_POLLS:
                    in_run, silent = not _reset_to_zero(setup.tool, life.publisher), SILENT_POLLS - RETRY_POLLS


def _reset_to_zero(tool: Tool, publisher: zmq.Socket) -> bool:
    """Reset the device and publish the outcome; return whether the motor is at zero."""
    begin_s = time.monotonic()
    try:
        reset_device(tool)
    except ToolError as error:
        publisher.send_multipart(bus.pack_notice(MotorNotZeroed(str(error))))
        return False
    took_ms = (time.monotonic() - begin_s) * 1e3
    silent_ms = RESET_AFTER_SILENCE_S * 1e3
    text = (
        f"The acquisition was silent for {silent_ms:.0f} ms: the motor is at zero by a reset that took {took_ms:.0f} ms"
    )
    publisher.send_multipart(bus.pack_notice(MotorZeroed(text)))
    return True
