"""Whether the server, through which STOP comes, still lives: judged by the signs of life that its event loop sends."""

MAX_CHECK_INTERVAL_S = 0.05
"""Between two looks more than this is a delay of the looking process itself, and no silence of the server's."""


class ServerWatchdog:
    """Counts for how long the server has been silent while this process could have heard it.

    Take what waits to be read before each look: a sign of life that waits was no silence.
    """

    def __init__(self, max_silence_s: float) -> None:
        """`most_s` is the longest silence that a run may go on in, s."""
        self._max_silence_s = max_silence_s
        self._silent_s = 0.0
        self._last_check_s = 0.0

    def on_heartbeat(self) -> None:
        """A sign of life, or a command, has come."""
        self._silent_s = 0.0

    def check(self, now_s: float) -> str | None:
        """Why a run must not go on, or None; to be called at every turn. `now_s` is of the monotonic clock."""
        self._silent_s += min(now_s - self._last_check_s, MAX_CHECK_INTERVAL_S)
        self._last_check_s = now_s
        if self._silent_s <= self._max_silence_s:
            return None
        return f"the server was not heard for {self._max_silence_s:.1f} s, and STOP could not have come through"
