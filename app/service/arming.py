"""Whether the tool is armed, as its acquisition tells; arming, disarming, and faults that stay until acknowledged."""

import asyncio
from collections.abc import Callable

from acquisition import bus
from acquisition.safety_state_machine import MONITORED_STATES, MOTOR_ACTIVE_STATES, Safety
from acquisition.sample_block import SampleBlock
from app.messages.wire import Alarm, AlarmKind, Priority
from app.service.commander import ANSWER_TIMEOUT_S, Commander
from app.service.supervisor import Supervisor
from app.stream.alarms import AlarmManager
from config.errors import RefusedError

FAULT_ALARM_KEY = "fault"
CALIBRATION_ARM_REASON = "for a calibration with empty jaws at half a volt"
"""The one reason that needs no admin: without it no tool could be calibrated. It admits nothing but that."""
SELF_TEST_TIMEOUT_S = 3.0
"""The self-test waits up to a second for the jaws to come to rest."""


class ArmingController:
    """Follows the state machine of the acquisition worker, and remembers its fault when that worker dies."""

    def __init__(
        self, commander: Commander, alarms: AlarmManager, supervisor: Supervisor, publish_event: Callable[..., None]
    ) -> None:
        self._commander, self._alarms, self._supervisor = commander, alarms, supervisor
        self._publish_event = publish_event
        self._safety_changed = asyncio.Event()
        self.safety, self.why = Safety.DISARMED, ""
        self.unmeasured_scale_reason = ""  # why it was armed without a measured force scale

    def update_from_block(self, block: SampleBlock) -> bool:
        """Take what a block says; returns whether it is news to people."""
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
        """The acquisition worker is gone: if the tool was armed, the next worker begins with that fault."""
        if self.safety is Safety.FAULTED:
            why = self.why
            self._raise_fault_alarm()  # its acknowledgement may have gone down with the worker
        elif self.safety not in MONITORED_STATES:
            self.safety, why = Safety.DISARMED, ""
        else:
            self.safety, self.why = Safety.FAULTED, why
            self._raise_fault_alarm()
        self._supervisor.set_initial_fault(why)
        self._safety_changed.set()

    async def arm(self, by: str | None, unmeasured_scale_reason: str = "") -> None:
        """Test the tool; it is armed when this returns.

        `unmeasured`: why it may be although its force scale is not measured.

        Raises:
            RefusedError: it cannot be; the text says why and what to do.
            ServiceError: the acquisition does not answer.
        """
        if not self._supervisor.has_safety_monitor:
            raise RefusedError("The guard, who zeroes the motor of a hung tool, does not run: see the alarms.")
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

    async def _wait_for_self_test(self) -> None:
        """The worker has obeyed; its blocks from now on tell how that goes."""
        if self.safety is not Safety.ARMED:
            await self._wait_for_change()
        while self.safety is Safety.TESTING:
            await self._wait_for_change()

    async def _wait_for_change(self) -> None:
        """The next one."""
        self._safety_changed.clear()
        await self._safety_changed.wait()

    async def disarm(self, by: str | None) -> None:
        """Motor to zero; nothing starts before the tool is armed again.

        Raises:
            ServiceError: the acquisition does not answer.
        """
        await self._commander.send(bus.DisarmCommand())
        self._publish_event("Disarmed", by=by)

    async def acknowledge(self, alarm_id: str, seen_priority: Priority, by: str) -> Alarm:
        """Somebody has seen an alarm. That of a fault unlatches it: the tool can be armed again.

        Raises:
            RefusedError: there is no such alarm any more, it is worse by now, or the fault is there again.
            ServiceError: the acquisition does not answer.
        """
        if self.safety is Safety.FAULTED and self._alarms.find_key(alarm_id) == FAULT_ALARM_KEY:
            self._alarms.check_acknowledgeable(alarm_id, seen_priority)
            await self._commander.send(bus.AcknowledgeCommand())
            self._supervisor.set_initial_fault("")
            await self._wait_until_unlatched()
        return self._alarms.acknowledge(alarm_id, seen_priority, by)

    async def _wait_until_unlatched(self) -> None:
        """Until the blocks say so as well: whoever is answered may start."""
        try:
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                while self.safety is Safety.FAULTED:
                    await self._wait_for_change()
        except TimeoutError:
            raise RefusedError(f"The tool is at fault again: {self.why}. See its alarm.") from None

    def check_no_fault(self) -> None:
        """
        Raises:
            RefusedError: a fault is latched; the text says how it is acknowledged.
        """
        if self.safety is not Safety.FAULTED:
            return
        alarm = next(
            (alarm for alarm in self._alarms.current_alarms() if self._alarms.find_key(alarm.id) == FAULT_ALARM_KEY),
            None,
        )
        where = f" (POST /api/alarms/{alarm.id}/acknowledge)" if alarm else ""
        raise RefusedError(f"A fault is latched: {self.why}. Acknowledge its alarm{where}, then start again.")
