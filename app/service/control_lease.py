"""The class ControlLease: control of the tool, which one operator at a time holds."""

import time
from collections.abc import Callable

from config.errors import RefusedError


class ControlLease:
    """A lease by name. It expires, its holder's actions renew it, and others take it over only explicitly."""

    def __init__(self, expires_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._expires_s, self._clock = expires_s, clock
        self._holder_name: str | None = None
        self._last_action_s = 0.0

    @property
    def holder(self) -> str | None:
        return self._holder_name if self._holder_name and self.expires_in_s else None

    @property
    def expires_in_s(self) -> float:
        """Time until the lease expires without action of its holder; 0 if it is free."""
        return max(self._last_action_s + self._expires_s - self._clock(), 0.0) if self._holder_name else 0.0

    def acquire(self, name: str, *, take_over: bool = False) -> str | None:
        """Acquire control for `name`, and return the previous holder.

        Raises:
            RefusedError: another person has control, and `take_over` is False.
        """
        before = self.holder
        if before not in (None, name) and not take_over:
            raise RefusedError(
                f"{before} has control of the tool, and keeps it for another {self.expires_in_s / 60:.1f} min without "
                "doing anything. Wait, ask for it, or take it over (programs: `take_over`).",
                "control",
            )
        self._holder_name, self._last_action_s = name, self._clock()
        return before

    def renew(self, name: str | None) -> None:
        """Renew the lease after an action of `name`, if `name` holds it."""
        if name and name == self.holder:
            self._last_action_s = self._clock()

    def release(self, name: str) -> bool:
        """Release control; return False if `name` does not have it."""
        if self.holder != name:
            return False
        self._holder_name = None
        return True
