"""The class ArmingController: arms and disarms the tool; faults stay latched until a person acknowledges them."""

import asyncio
import contextlib
import math
from collections.abc import Callable

from acquisition import bus
from acquisition.safety_state_machine import MONITORED_STATES, MOTOR_ACTIVE_STATES, Safety
from acquisition.sample_block import SampleBlock
from app.messages.alarms import Alarm, AlarmKind
from app.service.commander import ANSWER_TIMEOUT_S, Commander
from app.service.supervisor import Supervisor
from app.stream.alarms import AlarmManager
from config.errors import RefusedError
from config.schema import Tool
from estimator.force_alarms import Priority

FAULT_ALARM_KEY = "fault"
CALIBRATION_ARM_REASON = "for a calibration with empty jaws at half a volt"
"""The only reason that needs no admin, because no tool could be calibrated without it. It permits no other run."""
SELF_TEST_TIMEOUT_S = 3.0
"""Includes up to a second in which the self-test waits for the jaws to come to rest."""


class ArmingController:
    """The server's copy of the acquisition's safety state, which keeps a fault when that worker dies."""

    def __init__(
        self,
        tool: Tool,
        commander: Commander,
        alarms: AlarmManager,
        supervisor: Supervisor,
        publish_event: Callable[..., None],
    ) -> None:
        self._has_motor = tool.has_motor
        self._commander, self._alarms, self._supervisor = commander, alarms, supervisor
        self._publish_event = publish_event
        self._safety_changed = asyncio.Event()
        self._block_arrived = asyncio.Event()
        self._last_tick = -1.0  # of the last block; infinite after a death, which ends the wait for one
        self.safety, self.why = Safety.DISARMED, ""
        self.unmeasured_scale_reason = ""  # why the tool was armed without a measured force scale

    def update_from_block(self, block: SampleBlock) -> bool:
        """Adopt the safety state of a block; return whether it changed, other than between states of motion."""
        self._last_tick = int(block.samples["tick"][-1])
        self._block_arrived.set()
        if (block.safety, block.why) == (self.safety, self.why):
            return False
        before, self.safety, self.why = self.safety, block.safety, block.why
        self._safety_changed.set()
        if self.safety is Safety.FAULTED and before is not Safety.FAULTED:
            self._raise_fault_alarm()
        return not {before, self.safety} <= MOTOR_ACTIVE_STATES

    def _raise_fault_alarm(self) -> None:
        text = f"Fault, the motor is at zero: {self.why}. Acknowledge it before the tool can be armed again"
        self._alarms.raise_latched(FAULT_ALARM_KEY, AlarmKind.TECHNICAL, text)

    def on_worker_death(self, why: str) -> None:
        """Latch a fault if the tool was armed when the acquisition worker died; the next worker begins with it."""
        self._last_tick, self._commander.last_reply_tick = math.inf, -1
        self._block_arrived.set()
        if self.safety is Safety.FAULTED:
            why = self.why
            self._raise_fault_alarm()  # the dead worker may have lost the acknowledgment
        elif self.safety not in MONITORED_STATES or not self._has_motor:
            self.safety, why = Safety.DISARMED, ""
        else:
            self.safety, self.why = Safety.FAULTED, why
            self._raise_fault_alarm()
        self._supervisor.set_initial_fault(why)
        self._safety_changed.set()

    def on_worker_replacement(self) -> None:
        """The next acquisition worker begins disarmed, or with the fault that is latched; its ticks begin at zero."""
        self._last_tick, self._commander.last_reply_tick = math.inf, -1
        self._block_arrived.set()
        if self.safety is not Safety.FAULTED:
            self.safety, self.why = Safety.DISARMED, ""
        self._supervisor.set_initial_fault(self.why)
        self._safety_changed.set()

    async def arm(self, by: str | None, unmeasured_scale_reason: str = "") -> None:
        """Test the tool and arm it; it is armed when this returns.

        `unmeasured_scale_reason`: why the tool may be armed although its force scale is not measured.

        Raises:
            RefusedError: the tool cannot be armed; the text says why and what to do.
            ServiceError: the acquisition does not answer.
        """
        if not self._has_motor:
            raise RefusedError("The tool has no motor: nothing needs to be armed.")
        if not self._supervisor.has_safety_monitor:
            raise RefusedError("The safety monitor, which zeroes a hung tool's motor, does not run: see the alarms.")
        await self._commander.send(bus.ArmCommand(unmeasured_scale_reason))
        try:
            async with asyncio.timeout(SELF_TEST_TIMEOUT_S):
                await self._wait_for_self_test()
        except TimeoutError:
            raise RefusedError("The self-test did not end in time. See the alarms, then try again.") from None
        if self.safety is not Safety.ARMED:
            raise RefusedError(f"Not armed: {self.why or f'the tool is {self.safety.value}'}.")
        self.unmeasured_scale_reason = unmeasured_scale_reason
        without = f", without a measured force scale: {unmeasured_scale_reason}" if unmeasured_scale_reason else ""
        self._publish_event(f"Armed: tare and self-test passed{without}", by=by)

    async def wait_until_known(self) -> None:
        """Wait until a block shows the safety state after the last command, for a moment at most.

        A stop is answered before a block shows it; whoever starts right after it must not judge by the state before.
        """
        with contextlib.suppress(TimeoutError):  # no blocks come: an alarm says so
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                await self._wait_for_block_after_command()

    async def _wait_for_block_after_command(self) -> None:
        while self._last_tick <= self._commander.last_reply_tick:
            self._block_arrived.clear()
            await self._block_arrived.wait()

    async def _wait_for_self_test(self) -> None:
        """Wait until the blocks after the command show the end of the self-test that it has begun."""
        await self._wait_for_block_after_command()
        while self.safety is Safety.TESTING:
            await self._wait_for_change()

    async def _wait_for_change(self) -> None:
        self._safety_changed.clear()
        await self._safety_changed.wait()

    async def disarm(self, by: str | None) -> None:
        """Bring the motor to zero; no run starts before the tool is armed again.

        Raises:
            ServiceError: the acquisition does not answer.
        """
        await self._commander.send(bus.DisarmCommand())
        self._publish_event("Disarmed", by=by)

    async def acknowledge(self, alarm_id: str, seen_priority: Priority, by: str) -> Alarm:
        """Acknowledge an alarm for `by`. The alarm of a fault unlatches the fault, so that the tool can be armed again.

        Raises:
            RefusedError: the alarm is over, its priority has risen above `seen_priority`, or the fault has returned.
            ServiceError: the acquisition does not answer.
        """
        if self.safety is Safety.FAULTED and self._alarms.find_key(alarm_id) == FAULT_ALARM_KEY:
            self._alarms.check_acknowledgeable(alarm_id, seen_priority)
            await self._commander.send(bus.AcknowledgeCommand())
            self._supervisor.set_initial_fault("")
            await self._wait_until_unlatched()
        return self._alarms.acknowledge(alarm_id, seen_priority, by)

    async def _wait_until_unlatched(self) -> None:
        """Wait until the blocks show no fault, because the caller may start a run at once."""
        try:
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                while self.safety is Safety.FAULTED:
                    await self._wait_for_change()
        except TimeoutError:
            raise RefusedError(f"The tool is at fault again: {self.why}. See its alarm.") from None

    def check_no_fault(self) -> None:
        """Check that no fault is latched.

        Raises:
            RefusedError: a fault is latched; the text says how to acknowledge it.
        """
        if self.safety is not Safety.FAULTED:
            return
        raise RefusedError(f"A fault is latched: {self.why}. Acknowledge its alarm, then start again.")
