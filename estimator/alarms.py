"""Warnings of force against the injury threshold in force."""

from dataclasses import dataclass
from enum import StrEnum

from config.schema import Warnings


class Priority(StrEnum):
    LOW = "low"
    MEDIUM = "medium"
    HIGH = "high"


@dataclass(frozen=True, slots=True)
class ForceAlarm:
    """The force passed a share of the threshold, or fell back (`priority` None)."""

    tick: int
    priority: Priority | None
    force_n: float
    threshold_n: float
    threshold_tissue: str | None


class ForceWarnings:
    """Follows the force; says when the warning's priority changes, with hysteresis downwards."""

    def __init__(self, shares: Warnings) -> None:
        self._begin = {Priority.LOW: shares.low, Priority.MEDIUM: shares.medium, Priority.HIGH: shares.high}
        self._hysteresis = shares.hysteresis
        self._now: Priority | None = None
        self._tissue: str | None = None

    def update(self, tick: int, force_n: float, threshold_n: float, threshold_tissue: str | None) -> ForceAlarm | None:
        """Take the force and the threshold in force, N; returns the change, if there is one."""
        share = force_n / threshold_n
        reached = None
        for priority, begin in self._begin.items():
            held = self._now is not None and begin <= self._begin[self._now]
            if share >= begin - (self._hysteresis if held else 0.0):
                reached = priority
        if reached is self._now and (reached is None or threshold_tissue == self._tissue):
            return None
        self._now, self._tissue = reached, threshold_tissue
        return ForceAlarm(tick, reached, force_n, threshold_n, threshold_tissue)
