"""The alarms that are on: raised, changed and ended here, told to the viewers at once."""

import time
from collections.abc import Callable

from pydantic import BaseModel

from app.wire import Alarm, AlarmKind, Priority
from estimator.alarms import ForceAlarm

FORCE = "force"
SHARE_TEXT = {
    Priority.LOW: "Force near the injury threshold",
    Priority.MEDIUM: "Force close to the injury threshold",
    Priority.HIGH: "Force over the injury threshold",
}


class AlarmBook:
    """At most one alarm a key; its `id` stays the same until it ends."""

    def __init__(self, tell: Callable[[BaseModel], None]) -> None:
        self._tell = tell
        self._active: dict[str, Alarm] = {}
        self._count = 0

    def active(self) -> list[Alarm]:
        return list(self._active.values())

    def technical_texts(self) -> list[str]:
        return [alarm.text for alarm in self._active.values() if alarm.kind is AlarmKind.TECHNICAL]

    def raise_technical(self, key: str, priority: Priority, text: str) -> None:
        self._raise(key, AlarmKind.TECHNICAL, priority, text)

    def force(self, change: ForceAlarm) -> None:
        """Take a change of the force warning."""
        if change.priority is None:
            self.end(FORCE)
            return
        priority = Priority(change.priority)
        whose = change.threshold_tissue.replace("_", " ") if change.threshold_tissue else "lowest of the library"
        text = f"{SHARE_TEXT[priority]} ({whose})"
        self._raise(FORCE, AlarmKind.FORCE, priority, text, change.force_n, change.threshold_n)

    def _raise(
        self, key: str, kind: AlarmKind, priority: Priority, text: str,
        value: float | None = None, limit: float | None = None,
    ) -> None:  # fmt: skip
        before = self._active.get(key)
        if before and (before.priority, before.text, before.limit) == (priority, text, limit):
            return
        if not before:
            self._count += 1
        self._active[key] = Alarm(
            id=before.id if before else f"{key}-{self._count}",
            kind=kind,
            priority=priority,
            active=True,
            text=text,
            value=value,
            limit=limit,
            unit="N" if kind is AlarmKind.FORCE else None,
            began_ms=before.began_ms if before else time.time() * 1e3,
        )
        self._tell(self._active[key])

    def end(self, key: str) -> None:
        alarm = self._active.pop(key, None)
        if alarm:
            self._tell(alarm.model_copy(update={"active": False}))
