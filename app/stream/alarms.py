"""The class AlarmManager: raises, changes, acknowledges and ends alarms, and publishes and journals this at once."""

from collections.abc import Callable

from pydantic import BaseModel

from app.audit.journal import Journal
from app.host.clock import now_ms
from app.messages.alarms import Alarm, AlarmKind
from app.messages.journal import JournalKind
from config.errors import RefusedError
from estimator.force_alarms import ForceAlarm, Priority

FORCE_ALARM_KEY, PEAK_FORCE_ALARM_KEY = "force", "force-peak"
PRIORITY_RANK = {Priority.LOW: 1, Priority.MEDIUM: 2, Priority.HIGH: 3}
FORCE_WARNING_TEXTS = {
    Priority.LOW: "Force near the injury threshold",
    Priority.MEDIUM: "Force close to the injury threshold",
    Priority.HIGH: "Force too close to the injury threshold",
}
OVER_THRESHOLD_TEXT = "Force over the injury threshold"


class AlarmManager:
    """Manager of at most one alarm a key, whose `id` stays the same until it is over.

    The force alarm follows its cause. When it leaves the high priority unacknowledged, its peak becomes a separate
    latched alarm. Events that are over when they are reported latch, too, such as a released grasp. An acknowledged
    alarm that becomes worse has to be acknowledged again.
    """

    def __init__(self, publish: Callable[[BaseModel], None], journal: Journal | None = None) -> None:
        self._publish = publish
        self._journal = journal
        self._alarms: dict[str, Alarm] = {}
        self._alarm_count = 0

    def current_alarms(self) -> list[Alarm]:
        return list(self._alarms.values())

    def technical_alarm_texts(self) -> list[str]:
        """Return the texts of the technical alarms whose cause persists."""
        return [alarm.text for alarm in self._alarms.values() if alarm.kind is AlarmKind.TECHNICAL and alarm.active]

    def raise_technical(self, key: str, priority: Priority, text: str, at_ms: float | None = None) -> None:
        self._raise(key, AlarmKind.TECHNICAL, priority, text, at_ms)

    def update_technical(self, key: str, priority: Priority, fault: str | None) -> None:
        """Raise an alarm with the text of a fault, or end it if there is none."""
        if fault:
            self.raise_technical(key, priority, fault)
        else:
            self.end(key)

    def update_force_alarm(self, change: ForceAlarm, at_ms: float | None = None) -> None:
        """Apply a change of the force warning."""
        if change.priority is None:
            self.end_force_alarm(at_ms)
            return
        priority = change.priority
        if priority is not Priority.HIGH:
            self._latch_peak_force()
        whose = change.threshold_tissue.replace("_", " ") if change.threshold_tissue else "lowest of the library"
        words = OVER_THRESHOLD_TEXT if change.force_n >= change.threshold_n else FORCE_WARNING_TEXTS[priority]
        text = f"{words} ({whose})"
        self._raise(FORCE_ALARM_KEY, AlarmKind.FORCE, priority, text, at_ms, change.force_n, change.threshold_n)

    def update_peak_force(self, force_n: float | None) -> None:
        """Raise the force alarm's value to the present force, N, if that is higher."""
        alarm = self._alarms.get(FORCE_ALARM_KEY)
        if alarm and force_n is not None and alarm.value is not None and force_n > alarm.value:
            self._store(FORCE_ALARM_KEY, alarm.model_copy(update={"value": force_n}))

    def end_force_alarm(self, at_ms: float | None = None) -> None:
        """End the force alarm: the force has fallen, or its source is gone."""
        self._latch_peak_force()
        self.end(FORCE_ALARM_KEY, at_ms)

    def _latch_peak_force(self) -> None:
        """Latch the peak of an unacknowledged force alarm that leaves the high priority."""
        alarm = self._alarms.get(FORCE_ALARM_KEY)
        if alarm and alarm.priority is Priority.HIGH and alarm.acknowledged_by is None:
            self.raise_latched(
                PEAK_FORCE_ALARM_KEY, AlarmKind.FORCE, f"Peak: {alarm.text}", alarm.began_ms, alarm.value, alarm.limit
            )

    def raise_latched(
        self,
        key: str,
        kind: AlarmKind,
        text: str,
        at_ms: float | None = None,
        value: float | None = None,
        limit: float | None = None,
    ) -> None:
        """Raise a latched alarm of high priority for an event that is already over."""
        before = self._alarms.get(key)
        if before and (before.value or 0.0) > (value or 0.0):
            return  # keep the highest peak
        self._raise(key, kind, Priority.HIGH, text, at_ms, value, limit, latched=True)
        self.end(key)

    def _raise(
        self,
        key: str,
        kind: AlarmKind,
        priority: Priority,
        text: str,
        at_ms: float | None,
        value: float | None = None,
        limit: float | None = None,
        *,
        latched: bool = False,
    ) -> None:
        before = self._alarms.get(key)
        if before and (before.priority, before.text, before.value, before.limit) == (priority, text, value, limit):
            return
        if not before:
            self._alarm_count += 1
        worse = before is None or PRIORITY_RANK[priority] > PRIORITY_RANK[before.priority]
        alarm = Alarm(
            id=before.id if before else f"{key}-{self._alarm_count}",
            kind=kind,
            priority=priority,
            active=True,
            latched=latched,
            text=text,
            value=value,
            limit=limit,
            unit="N" if value is not None else None,
            began_ms=before.began_ms if before else _time_or_now_ms(at_ms),
            ended_ms=None,
            acknowledged_by=before.acknowledged_by if before and not worse else None,
        )
        alarm = self._store(key, alarm)
        if before is None or worse or text != before.text:
            self._write_journal_entry(JournalKind.ALARM, alarm, f"{priority.value.capitalize()} alarm: {text}")

    def end(self, key: str, at_ms: float | None = None) -> None:
        """End an alarm, whose cause is gone; a latched one stays."""
        alarm = self._alarms.get(key)
        if alarm and alarm.active:
            alarm = self._store(key, alarm.model_copy(update={"active": False, "ended_ms": _time_or_now_ms(at_ms)}))
            self._write_journal_entry(JournalKind.ALARM, alarm, f"Over: {alarm.text}")

    def find_key(self, alarm_id: str) -> str | None:
        """Return the key of an alarm that is on, or None."""
        return next((key for key, alarm in self._alarms.items() if alarm.id == alarm_id), None)

    def check_acknowledgeable(self, alarm_id: str, seen_priority: Priority) -> str:
        """Return the alarm's key if a person who saw it at `seen_priority` may acknowledge it.

        Raises:
            RefusedError: there is no such alarm any more, or it is worse by now.
        """
        key = self.find_key(alarm_id)
        if key is None:
            raise RefusedError("There is no alarm of this kind any more: nothing is left to acknowledge.", "id")
        if PRIORITY_RANK[self._alarms[key].priority] > PRIORITY_RANK[seen_priority]:
            raise RefusedError("The alarm is worse by now: look at it again.", "priority")
        return key

    def acknowledge(self, alarm_id: str, seen_priority: Priority, by: str) -> Alarm:
        """Acknowledge an alarm for a person; it is over if its cause is gone.

        Raises:
            RefusedError: there is no such alarm any more, or its priority is higher than `seen_priority` by now.
        """
        key = self.check_acknowledgeable(alarm_id, seen_priority)
        alarm = self._alarms[key].model_copy(update={"acknowledged_by": by, "latched": False})
        alarm = self._store(key, alarm)
        self._write_journal_entry(JournalKind.ACKNOWLEDGED, alarm, f"Acknowledged: {alarm.text}", by)
        return alarm

    def _store(self, key: str, alarm: Alarm) -> Alarm:
        before = self._alarms.get(key)
        alarm = alarm.model_copy(update={"change": before.change + 1 if before else 1})
        if alarm.active or alarm.latched:
            self._alarms[key] = alarm
        else:
            self._alarms.pop(key, None)
        self._publish(alarm)
        return alarm

    def _write_journal_entry(self, kind: JournalKind, alarm: Alarm, text: str, by: str | None = None) -> None:
        if self._journal:
            self._journal.write(
                kind,
                text,
                by=by,
                priority=alarm.priority,
                value=alarm.value,
                limit=alarm.limit,
                unit=alarm.unit,
                alarm=alarm,
            )


def _time_or_now_ms(at_ms: float | None) -> float:
    return now_ms() if at_ms is None else at_ms
