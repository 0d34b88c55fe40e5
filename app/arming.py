"""Whether the tool is armed, as its acquisition tells; arming, disarming, and faults that stay until acknowledged."""

import asyncio
from collections.abc import Callable

from acquisition import bus
from acquisition.blocks import SampleBlock
from acquisition.safety import MOVING, WATCHED, Safety
from app.alarms import AlarmBook
from app.commander import ANSWER_S, Commander
from app.supervisor import Supervisor
from app.wire import Alarm, AlarmKind, Priority
from config.errors import RefusedError

FAULT = "fault"
CALIBRATING = "for a calibration with empty jaws at half a volt"
"""The one reason that needs no admin: without it no tool could be calibrated. It admits nothing but that."""
TEST_S = 3.0
"""The self-test waits up to a second for the jaws to come to rest."""


class Arming:
    """Follows the state machine of the acquisition worker, and remembers its fault when that worker dies."""

    def __init__(
        self, commander: Commander, alarms: AlarmBook, supervisor: Supervisor, tell_event: Callable[..., None]
    ) -> None:
        self._commander, self._alarms, self._supervisor = commander, alarms, supervisor
        self._tell_event = tell_event
        self._changed = asyncio.Event()
        self.safety, self.why = Safety.DISARMED, ""
        self.unmeasured = ""  # why it was armed without a measured force scale

    def follow(self, block: SampleBlock) -> bool:
        """Take what a block says; returns whether it is news to people."""
        if (block.safety, block.why) == (self.safety, self.why):
            return False
        before, self.safety, self.why = self.safety, block.safety, block.why
        self._changed.set()
        if self.safety is Safety.FAULTED and before is not Safety.FAULTED:
            self._latch()
        return not {before, self.safety} <= MOVING

    def _latch(self) -> None:
        text = f"Fault, the motor is at zero: {self.why}. Acknowledge it before the tool can be armed again"
        self._alarms.happened(FAULT, AlarmKind.TECHNICAL, text)

    def died(self, why: str) -> None:
        """The acquisition worker is gone: if the tool was armed, the next worker begins with that fault."""
        if self.safety is Safety.FAULTED:
            why = self.why
            self._latch()  # its acknowledgement may have gone down with the worker
        elif self.safety not in WATCHED:
            self.safety, why = Safety.DISARMED, ""
        else:
            self.safety, self.why = Safety.FAULTED, why
            self._latch()
        self._supervisor.begin_with_fault(why)
        self._changed.set()

    async def arm(self, by: str | None, unmeasured: str = "") -> None:
        """Test the tool; it is armed when this returns.

        `unmeasured`: why it may be although its force scale is not measured.

        Raises:
            RefusedError: it cannot be; the text says why and what to do.
            ServiceError: the acquisition does not answer.
        """
        if not self._supervisor.is_guarded:
            raise RefusedError("The guard, who zeroes the motor of a hung tool, does not run: see the alarms.")
        await self._commander.send(bus.Arm(unmeasured))
        try:
            async with asyncio.timeout(TEST_S):
                await self._while_testing()
        except TimeoutError:
            raise RefusedError("The self-test did not end in time. See the alarms, then try again.") from None
        if self.safety is not Safety.ARMED:
            raise RefusedError(f"Not armed: {self.why or f'the tool is {self.safety.value}'}.")
        self.unmeasured = unmeasured
        without = f", without a measured force scale: {unmeasured}" if unmeasured else ""
        self._tell_event(f"Armed: tare and self-test passed{without}", by=by)

    async def _while_testing(self) -> None:
        """The worker has obeyed; its blocks from now on tell how that goes."""
        if self.safety is not Safety.ARMED:
            await self._change()
        while self.safety is Safety.TESTING:
            await self._change()

    async def _change(self) -> None:
        """The next one."""
        self._changed.clear()
        await self._changed.wait()

    async def disarm(self, by: str | None) -> None:
        """Motor to zero; nothing starts before the tool is armed again.

        Raises:
            ServiceError: the acquisition does not answer.
        """
        await self._commander.send(bus.Disarm())
        self._tell_event("Disarmed", by=by)

    async def acknowledge(self, alarm_id: str, seen: Priority, by: str) -> Alarm:
        """Somebody has seen an alarm. That of a fault unlatches it: the tool can be armed again.

        Raises:
            RefusedError: there is no such alarm any more, it is worse by now, or the fault is there again.
            ServiceError: the acquisition does not answer.
        """
        if self.safety is Safety.FAULTED and self._alarms.key_of(alarm_id) == FAULT:
            self._alarms.check(alarm_id, seen)
            await self._commander.send(bus.Acknowledge())
            self._supervisor.begin_with_fault("")
            await self._until_unlatched()
        return self._alarms.acknowledge(alarm_id, seen, by)

    async def _until_unlatched(self) -> None:
        """Until the blocks say so as well: whoever is answered may start."""
        try:
            async with asyncio.timeout(ANSWER_S):
                while self.safety is Safety.FAULTED:
                    await self._change()
        except TimeoutError:
            raise RefusedError(f"The tool is at fault again: {self.why}. See its alarm.") from None

    def check_fault(self) -> None:
        """
        Raises:
            RefusedError: a fault is latched; the text says how it is acknowledged.
        """
        if self.safety is not Safety.FAULTED:
            return
        alarm = next((alarm for alarm in self._alarms.all() if self._alarms.key_of(alarm.id) == FAULT), None)
        where = f" (POST /api/alarms/{alarm.id}/acknowledge)" if alarm else ""
        raise RefusedError(f"A fault is latched: {self.why}. Acknowledge its alarm{where}, then start again.")
