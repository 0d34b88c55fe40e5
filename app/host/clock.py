"""The service's clock: milliseconds since 1970, never stepped."""

import time

WALL_CLOCK_OFFSET_MS = time.time() * 1e3 - time.monotonic() * 1e3


def now_ms() -> float:
    return time.monotonic() * 1e3 + WALL_CLOCK_OFFSET_MS


def monotonic_to_wall_ms(t_mono_ns: int) -> float:
    """A moment of `time.monotonic_ns` on this clock."""
    return t_mono_ns / 1e6 + WALL_CLOCK_OFFSET_MS
