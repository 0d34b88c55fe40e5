"""The alarms that are on: raised, changed, acknowledged and ended here, told to the viewers and the journal at once."""

from collections.abc import Callable

from pydantic import BaseModel

from app.clock import now_ms
from app.journal import Journal
from app.wire import Alarm, AlarmKind, JournalKind, Priority
from config.errors import RefusedError
from estimator.alarms import ForceAlarm

FORCE = "force"
RANK = {Priority.LOW: 1, Priority.MEDIUM: 2, Priority.HIGH: 3}
SHARE_TEXT = {
    Priority.LOW: "Force near the injury threshold",
    Priority.MEDIUM: "Force close to the injury threshold",
    Priority.HIGH: "Force too close to the injury threshold",
}
OVER_TEXT = "Force over the injury threshold"


class AlarmBook:
    """At most one alarm a key; its `id` stays the same until it is over.

    A force over the limit latches: it stays, though its cause is gone, until somebody has acknowledged it. So does what
    is over when it is told: a grasp that was let go, a run that failed. An acknowledged alarm that becomes worse is a
    new one to people: the acknowledgement is taken back.
    """

    def __init__(self, tell: Callable[[BaseModel], None], journal: Journal | None = None) -> None:
        self._tell = tell
        self._journal = journal
        self._alarms: dict[str, Alarm] = {}
        self._count = 0

    def all(self) -> list[Alarm]:
        return list(self._alarms.values())

    def technical_texts(self) -> list[str]:
        """Of those whose cause is there."""
        return [alarm.text for alarm in self._alarms.values() if alarm.kind is AlarmKind.TECHNICAL and alarm.active]

    def raise_technical(self, key: str, priority: Priority, text: str, at_ms: float | None = None) -> None:
        self._raise(key, AlarmKind.TECHNICAL, priority, text, at_ms)

    def force(self, change: ForceAlarm, at_ms: float | None = None) -> None:
        """Take a change of the force warning."""
        if change.priority is None:
            self.end(FORCE, at_ms)
            return
        priority = Priority(change.priority)
        whose = change.threshold_tissue.replace("_", " ") if change.threshold_tissue else "lowest of the library"
        words = OVER_TEXT if change.force_n >= change.threshold_n else SHARE_TEXT[priority]
        self._raise(
            FORCE, AlarmKind.FORCE, priority, f"{words} ({whose})", at_ms, change.force_n, change.threshold_n,
            latches=priority is Priority.HIGH,
        )  # fmt: skip

    def happened(self, key: str, kind: AlarmKind, text: str) -> None:
        """Something is over when it is told, but somebody has to know of it: a high alarm that latches."""
        self._raise(key, kind, Priority.HIGH, text, None, latches=True)
        self.end(key)

    def _raise(
        self, key: str, kind: AlarmKind, priority: Priority, text: str, at_ms: float | None,
        value: float | None = None, limit: float | None = None, *, latches: bool = False,
    ) -> None:  # fmt: skip
        before = self._alarms.get(key)
        if before and before.latched and RANK[priority] < RANK[before.priority]:
            return  # what latched is shown until it is acknowledged, not what came after it
        again = before is not None and not before.active
        if before and not again and (before.priority, before.text, before.limit) == (priority, text, limit):
            return
        if not before:
            self._count += 1
        worse = before is None or again or RANK[priority] > RANK[before.priority]
        alarm = Alarm(
            id=before.id if before else f"{key}-{self._count}",
            kind=kind,
            priority=priority,
            active=True,
            latched=latches and (worse or before.latched),
            text=text,
            value=value,
            limit=limit,
            unit="N" if kind is AlarmKind.FORCE else None,
            began_ms=before.began_ms if before else _at(at_ms),
            ended_ms=None,
            acknowledged_by=None if worse else before.acknowledged_by,
        )
        self._keep(key, alarm)
        if worse or text != before.text:
            self._note(JournalKind.ALARM, alarm, f"{priority.value.capitalize()} alarm: {text}")

    def end(self, key: str, at_ms: float | None = None) -> None:
        """The cause is gone."""
        alarm = self._alarms.get(key)
        if alarm and alarm.active:
            self._keep(key, alarm.model_copy(update={"active": False, "ended_ms": _at(at_ms)}))
            self._note(JournalKind.ALARM, alarm, f"Over: {alarm.text}")

    def acknowledge(self, alarm_id: str, by: str) -> Alarm:
        """Somebody has seen it; an alarm whose cause is gone is over with that.

        Raises:
            RefusedError: there is no such alarm any more.
        """
        key = next((key for key, alarm in self._alarms.items() if alarm.id == alarm_id), None)
        if key is None:
            raise RefusedError(f"There is no alarm {alarm_id!r} any more. GET /api/alarms lists those that are on.")
        alarm = self._alarms[key].model_copy(update={"acknowledged_by": by, "latched": False})
        self._keep(key, alarm)
        self._note(JournalKind.ACKNOWLEDGED, alarm, f"Acknowledged: {alarm.text}", by)
        return alarm

    def _keep(self, key: str, alarm: Alarm) -> None:
        if alarm.active or alarm.latched:
            self._alarms[key] = alarm
        else:
            self._alarms.pop(key, None)
        self._tell(alarm)

    def _note(self, kind: JournalKind, alarm: Alarm, text: str, by: str | None = None) -> None:
        if self._journal:
            self._journal.write(
                kind, text, by=by, priority=alarm.priority, value=alarm.value, limit=alarm.limit, unit=alarm.unit
            )


def _at(at_ms: float | None) -> float:
    return now_ms() if at_ms is None else at_ms
