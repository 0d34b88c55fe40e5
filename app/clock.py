"""The service's clock: milliseconds since 1970, never stepped."""

import time

OFFSET_MS = time.time() * 1e3 - time.monotonic() * 1e3


def now_ms() -> float:
    return time.monotonic() * 1e3 + OFFSET_MS


def wall_ms(t_mono_ns: int) -> float:
    """A moment of `time.monotonic_ns` on this clock."""
    return t_mono_ns / 1e6 + OFFSET_MS
