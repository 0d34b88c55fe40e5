"""The class ForceAlarmMonitor, which compares the measured force with the injury threshold that counts now."""

from dataclasses import dataclass
from enum import StrEnum

from config.schema import WarningSettings


class Priority(StrEnum):
    LOW = "low"
    MEDIUM = "medium"
    HIGH = "high"


@dataclass(frozen=True, slots=True)
class ForceAlarm:
    """The force passed a share of the threshold, or fell below all of them (`priority` None)."""

    tick: int
    priority: Priority | None
    force_n: float
    threshold_n: float
    threshold_tissue: str | None


class ForceAlarmMonitor:
    """Monitor that reports changes of the alarm's priority, with hysteresis while the force falls."""

    def __init__(self, shares: WarningSettings) -> None:
        self._onset_shares = {Priority.LOW: shares.low, Priority.MEDIUM: shares.medium, Priority.HIGH: shares.high}
        self._hysteresis = shares.hysteresis
        self._priority: Priority | None = None
        self._tissue: str | None = None

    def find_exceeded(self, force_n: float, threshold_n: float) -> list[Priority]:
        """Return the priorities whose share of the threshold the force has reached."""
        return [priority for priority, share in self._onset_shares.items() if force_n >= share * threshold_n]

    def update(self, tick: int, force_n: float, threshold_n: float, threshold_tissue: str | None) -> ForceAlarm | None:
        """Return the alarm if its priority or tissue has changed since the last call, else None.

        Args:
            force_n: jaw force, N.
            threshold_n: injury threshold, N.
        """
        share = force_n / threshold_n
        reached = None
        for priority, begin in self._onset_shares.items():
            held = self._priority is not None and begin <= self._onset_shares[self._priority]
            if share >= begin - (self._hysteresis if held else 0.0):
                reached = priority
        if reached is self._priority and (reached is None or threshold_tissue == self._tissue):
            return None
        self._priority, self._tissue = reached, threshold_tissue
        return ForceAlarm(tick, reached, force_n, threshold_n, threshold_tissue)
