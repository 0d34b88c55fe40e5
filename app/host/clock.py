"""Functions of the service's clock: milliseconds since 1970, without steps when the system's time is set."""

import time

WALL_CLOCK_OFFSET_MS = time.time() * 1e3 - time.monotonic() * 1e3


def now_ms() -> float:
    return time.monotonic() * 1e3 + WALL_CLOCK_OFFSET_MS


def monotonic_to_wall_ms(t_mono_ns: int) -> float:
    """Return a time of `time.monotonic_ns` as milliseconds since 1970 by this clock."""
    return t_mono_ns / 1e6 + WALL_CLOCK_OFFSET_MS
