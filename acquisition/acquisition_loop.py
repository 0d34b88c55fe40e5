"""The class AcquisitionController: reads a block, conditions it, checks sensors and force, sets the motor command."""

import math
from dataclasses import replace

import numpy as np

from acquisition.drivers.command_history import CommandBounds, CommandHistory
from acquisition.drivers.source import SampleSource
from acquisition.notices import RunEnded, RunOutcome
from acquisition.protocol_player import ProtocolPlayer
from acquisition.safety.force_limiter import (
    ForceLimiter,
    compute_finite_median,
    compute_max_command_by_rise_limit,
    find_stop_reason,
)
from acquisition.safety.self_test import SelfTest
from acquisition.safety.sensor_monitor import SensorMonitor
from acquisition.safety_state_machine import (
    MONITORED_STATES,
    MOTOR_ACTIVE_STATES,
    RUN_STATES,
    Safety,
    SafetyEvent,
    next_state,
)
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock, SampleFlag
from acquisition.signals.pipeline import ConditioningPipeline
from config.errors import RefusedError
from config.schema import ConditioningSettings, GraspProtocol, Tool

READBACK_TOLERANCE_V = 0.25
# By the board's clock. A shorter mismatch may be a line that settles, or a driver that counts in bursts.
MAX_READBACK_MISMATCH_S = 0.09
PROMPT_READ_S = 0.01  # a reader that is at most this far behind its board does not lag
MAX_BACKLOG_S = 1.0  # with a larger backlog the present force is not known
LIMITED, RELEASED = SampleFlag.LIMITED.value, SampleFlag.RELEASED.value
NEW_SPOT = SampleFlag.NEW_SPOT.value


SCALE_UNKNOWN_TEXT = (
    "The tool's force scale is not measured, so its newtons may be wrong by a large factor. Measure it and state it "
    "under [calibration.jaw_force_scale] in the tool file, or have an admin arm the tool with a reason "
    "(`unmeasured_scale`)."
)


def describe_release(why: str) -> str:
    """Return the notice's text for a grasp that the limiter released."""
    return f"The grasp was let go with the motor at zero: {why}."


class AcquisitionController:
    """Control of one sample source and its motor, which moves only while a run plays its protocol."""

    def __init__(
        self,
        source: SampleSource,
        tool: Tool,
        conditioning: ConditioningSettings,
        limiter: ForceLimiter | None = None,
        safety: Safety = Safety.DISARMED,
        why: str = "",
    ) -> None:
        """`limiter` limits the force of a run; a recording has no motor and needs none.

        `safety` and `why` are the initial state and its reason: a fault outlives the process in which it occurred. A
        simulated tool in virtual time may begin armed, and a tool without a motor always does.
        """
        self._source = source
        self._tool = tool
        self._pipeline = ConditioningPipeline(tool, conditioning)
        self._sensor_monitor = SensorMonitor(tool)
        self._self_test = SelfTest(tool)
        self.safety, self.why = safety, why
        if not tool.has_motor:
            self.safety, self.why = Safety.ARMED, ""
        self._player: ProtocolPlayer | None = None
        self._run_id = ""
        self._ended_runs: list[RunEnded] = []
        self._test_failure = (
            "the tool did not stay at rest for long enough: try again"  # reason of the last failed check
        )
        self._limiter = limiter
        self._limiter_flags = 0  # LIMITED and RELEASED, for the next command to be written
        self._spot_requested = False
        self._release_reasons: list[str] = []
        rate_hz = tool.board.sample_rate_hz
        self._prompt_backlog, self._max_backlog = round(PROMPT_READ_S * rate_hz), round(MAX_BACKLOG_S * rate_hz)
        self._command_history = CommandHistory()
        self.last_tick = -1  # of the last sample that was processed
        self._backlog_samples = 0  # samples that the reader still has to catch up
        self._max_mismatched_samples = round(MAX_READBACK_MISMATCH_S * rate_hz)
        self._mismatched_samples = 0  # consecutive samples whose command was read back wrong

    @property
    def running(self) -> bool:
        return self._player is not None

    @property
    def at_rest(self) -> bool:
        """Whether neither a run nor the self-test is under way, so that no sample is waited for."""
        return not self.running and self.safety is not Safety.TESTING

    @property
    def _is_monitored(self) -> bool:
        """Whether a doubtful sensor ends the run; without a motor nothing needs to be ended."""
        return self._tool.has_motor and self.safety in MONITORED_STATES

    def arm(self, unmeasured_scale_reason: str = "") -> None:
        """Begin the self-test and a new tare; an armed tool stays armed.

        A later block arms the tool, or disarms it with the reason in `why`. `unmeasured_scale_reason` is the reason for
        which a real tool may move although its force scale is not measured.

        Raises:
            RefusedError: a run is under way, a fault is latched, or the force scale is not measured.
        """
        if not (self._tool.has_known_scale or unmeasured_scale_reason):
            raise RefusedError(SCALE_UNKNOWN_TEXT)
        if self._apply_event(SafetyEvent.ARM):
            self._self_test.start()
            self._restart_tare()

    def disarm(self) -> None:
        """Set the motor to zero and forbid runs until the tool is armed again."""
        self._end_run(SafetyEvent.DISARM, RunOutcome.STOPPED, "the tool was disarmed")

    def acknowledge(self) -> None:
        """Clear the latched fault, which a person has seen.

        Raises:
            RefusedError: no fault is latched.
        """
        self._apply_event(SafetyEvent.ACKNOWLEDGE)

    def start(self, run_id: str, protocol: GraspProtocol, cycles: int) -> None:
        """Begin a run with new measurements; the strain gage is tared during the protocol's lead-in.

        Raises:
            RefusedError: the tool is not armed, a run is under way, or the protocol exceeds the tool's limits.
        """
        next_state(self.safety, SafetyEvent.START)  # refuses a tool that is not armed before it checks the protocol
        player = ProtocolPlayer(protocol, self._tool, cycles)
        self._apply_event(SafetyEvent.START)
        self._run_id, self._player = run_id, player

    def set_threshold(self, threshold_n: float, tick: int) -> None:
        """Set the injury threshold in force, N, as known at sample `tick`; it counts until it expires."""
        if self._limiter is not None:
            self._limiter.set_threshold(threshold_n, tick)

    def begin_spot(self) -> None:
        """Mark the next sample as the first of a new spot.

        Raises:
            RefusedError: no run is under way.
        """
        if not self.running:
            raise RefusedError("No run is under way. Each run begins a new spot, so just start one.")
        self._spot_requested = True

    def stop(self, why: str) -> bool:
        """Set the motor to zero at once, in every state; return whether this ended a run."""
        return self._end_run(SafetyEvent.STOP, RunOutcome.STOPPED, why)

    def restart_after_reopen(self, why: str) -> None:
        """Continue with a reopened board: fail the run, if there is one, and require that the tool is armed again."""
        self._command_history, self._backlog_samples = CommandHistory(), 0
        if self.running:
            self.fail(why)
        self.disarm()
        if self.safety is Safety.DISARMED:
            self.why = why
        self._restart_tare()

    def fail(self, why: str) -> None:
        """Set the motor to zero at once and latch this fault until a person acknowledges it."""
        self._end_run(SafetyEvent.FAULT, RunOutcome.FAILED, why)
        if self._tool.has_motor:
            self.why = why

    def _end_run(self, event: SafetyEvent, end: RunOutcome, why: str) -> bool:
        self._limiter_flags = 0
        if self._limiter is not None:
            self._limiter.reset_limit()
        self._write_command(0.0)
        self._apply_event(event)
        if not self.running:
            return False
        self._player = None
        self._ended_runs.append(RunEnded(self._run_id, end, why))
        return True

    def _apply_event(self, event: SafetyEvent) -> bool:
        """Change the state; return whether it differs from the one before."""
        before, self.safety = self.safety, next_state(self.safety, event)
        if not self._tool.has_motor and self.safety not in RUN_STATES:
            self.safety = Safety.ARMED  # nothing can move
        if before is not self.safety and event is not SafetyEvent.FAULT:
            self.why = ""
        return before is not self.safety

    def process_block(self) -> SampleBlock | None:
        """Read and condition the next block and set the command that follows it; None at a recording's end.

        Raises:
            ToolError: the board failed; the motor has been commanded to zero.
        """
        raw = self._source.read_block()
        if raw is None:
            return None
        if not len(raw):
            return SampleBlock(0, raw.t_mono_ns, 0, np.zeros(0, SAMPLE_DTYPE), safety=self.safety, why=self.why)
        if self._player is not None and self._player.at_start:
            self._sensor_monitor.reset()  # the run's first block restarts the tare, too
        commands = self._command_history.compute_bounds(raw.first_tick, len(raw))
        limit_n = self._limiter.limit_n if self._limiter else math.nan
        run_id = self._run_id if self.running else ""
        block = self._pipeline.process(replace(raw, limiter_flags=commands.flags, limit_n=limit_n, run=run_id))
        if self._spot_requested:
            block.samples["flags"][0] |= NEW_SPOT
            self._spot_requested = False
        self.last_tick = raw.first_tick + len(raw) - 1
        caught_up = self._count_caught_up(raw.backlog)
        self._self_test.append(block.samples)
        tare = self._pipeline.tare
        lost = self._sensor_monitor.check(block.samples, tare.rest_v if tare.measured else math.nan)
        if self.safety is Safety.TESTING:
            self._continue_self_test(lost)
        elif self._is_monitored and (why := lost or self._find_stop_reason(block, commands)):
            self.fail(why)
        elif self._player is not None:
            if self._player.done:
                self._end_run(SafetyEvent.FINISH, RunOutcome.FINISHED, "all cycles are done")
            else:
                self._write_next_command(block, commands.likely_v, self._player.next_command(len(raw) - caught_up))
        return replace(block, safety=self.safety, why=self.why)

    def _continue_self_test(self, sensor_fault: str | None) -> None:
        """Pass once a tare is taken while the sensors are sound and the tool is at rest; fail at the time limit."""
        if why := self._self_test.find_fault_at_rest() or sensor_fault:
            self._test_failure = why
            self._restart_tare()
        elif self._pipeline.tare.measured:
            self._apply_event(SafetyEvent.TEST_PASSED)
        if self.safety is Safety.TESTING and self._self_test.timed_out:
            self._apply_event(SafetyEvent.TEST_FAILED)
            self.why = self._test_failure

    def _restart_tare(self) -> None:
        self._pipeline.restart_tare()
        self._sensor_monitor.reset()

    def _count_caught_up(self, backlog: int) -> int:
        """Return how many samples, at most a block, only made up for a delay of the reader.

        The protocol pauses for as many samples, so that it never plays faster than real time.
        """
        before, self._backlog_samples = self._backlog_samples, max(backlog - self._prompt_backlog, 0)
        return min(max(before - self._backlog_samples, 0), self._tool.board.block_samples)

    def _find_stop_reason(self, block: SampleBlock, commands: CommandBounds) -> str | None:
        """Return why a run must end after this block, or None."""
        if self.safety not in RUN_STATES:
            return None
        return find_stop_reason(self._tool, block.samples) or self._find_motion_fault(block, commands)

    def _write_next_command(self, block: SampleBlock, applied_v: list[float], requested_v: float) -> None:
        """Write the requested command, or the limiter's lower one, after a block taken under `applied_v`."""
        if self._limiter is None:
            self._write_command(requested_v)
            return
        was_let_go = self._limiter.release_reason
        command_v, self._limiter_flags = self._limiter.limit_command(block.samples, applied_v, requested_v)
        self._apply_event(_event_from_flags(self._limiter_flags))
        self._write_command(command_v)
        if (why := self._limiter.release_reason) and not was_let_go:
            self._release_reasons.append(why)

    def _find_motion_fault(self, block: SampleBlock, commands: CommandBounds) -> str | None:
        """Return a fault that forbids motion: no tare, samples read too late, or a wrong read-back of the command."""
        tare, calibration = self._pipeline.tare, self._tool.calibration
        if self._player and not self._player.in_lead_in and not tare.measured:
            seen_v = float(block.samples["strain_v"].mean())
            return (
                f"the strain gage rests at {seen_v:.3f} V, the tool file expects {calibration.rest_offset_v:.3f} V "
                f"within {calibration.rest_tolerance_v:.3f} V: it was not tared"
            )
        if block.backlog > self._max_backlog:
            late_s = block.backlog / self._tool.board.sample_rate_hz
            return f"the samples were read {late_s:.1f} s late: the force is not known; end other programs"
        off_v = compute_finite_median(commands.compute_deviations_v(block.samples["motor_command_v"].tolist()))
        is_astray = off_v is None or off_v > READBACK_TOLERANCE_V
        self._mismatched_samples = self._mismatched_samples + len(block.samples) if is_astray else 0
        if self._mismatched_samples >= self._max_mismatched_samples:
            off = "as no number" if off_v is None else f"{off_v:.2f} V off"
            return f"the motor command of {commands.likely_v[-1]:.2f} V is read back {off}: check its wiring"
        return None

    def _write_command(self, command_v: float) -> None:
        """Write the command, V, with its rise bounded; a fall is immediate, and an inactive motor gets zero."""
        most_v = (
            compute_max_command_by_rise_limit(self._command_history.last_command_v, self._tool)
            if self.safety in MOTOR_ACTIVE_STATES
            else 0.0
        )
        command_v = min(command_v, most_v)
        if (command_v, self._limiter_flags) != (
            self._command_history.last_command_v,
            self._command_history.last_flags,
        ) or command_v == 0.0:
            self._command_history.append(self._source.write_command(command_v), self._limiter_flags)

    def pop_ended_runs(self) -> list[RunEnded]:
        """Return the runs that ended since the last call."""
        ended, self._ended_runs = self._ended_runs, []
        return ended

    def pop_release_reasons(self) -> list[str]:
        """Return why the limiter released grasps since the last call."""
        let_go, self._release_reasons = self._release_reasons, []
        return let_go


def _event_from_flags(limiter_flags: int) -> SafetyEvent:
    if limiter_flags & RELEASED:
        return SafetyEvent.RELEASE_GRASP
    return SafetyEvent.LIMIT_FORCE if limiter_flags & LIMITED else SafetyEvent.RESUME
