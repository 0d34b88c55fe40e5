"""The class ServerWatchdog, which finds that a run must end because the server, through which STOP comes, is silent.

A heartbeat of the server's event loop shows that it is alive.
"""

MAX_CHECK_INTERVAL_S = 0.05
"""Longest time counted between two checks; a longer pause is a delay of this process, not a silence of the server."""


class ServerWatchdog:
    """Counter of the time for which the server was silent while this process could receive.

    Read all waiting messages before each check, so that a heartbeat in the queue is not counted as silence.
    """

    def __init__(self, max_silence_s: float) -> None:
        """`max_silence_s` is the longest silence in which a run may go on."""
        self._max_silence_s = max_silence_s
        self._silent_s = 0.0
        self._last_check_s = 0.0

    def on_heartbeat(self) -> None:
        """Reset the silence, on a heartbeat or a command."""
        self._silent_s = 0.0

    def check(self, now_s: float) -> str | None:
        """Return why a run must end, or None. Call it at every turn, with `now_s` of the monotonic clock."""
        self._silent_s += min(now_s - self._last_check_s, MAX_CHECK_INTERVAL_S)
        self._last_check_s = now_s
        if self._silent_s <= self._max_silence_s:
            return None
        return f"the server was not heard for {self._max_silence_s:.1f} s, and STOP could not have come through"
