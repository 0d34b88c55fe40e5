"""The class RateLimiter, which limits the rate of each client's requests."""

import time
from collections import OrderedDict
from collections.abc import Callable

MAX_CLIENTS = 10_000  # beyond that, the client idle for longest is forgotten; its bucket is full again by then


class RateLimiter:
    """Rate limiter with a token bucket for each client: `burst` attempts at once, and `rate_per_s` more each second."""

    def __init__(self, rate_per_s: float, burst: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate_per_s, self._burst, self._clock = rate_per_s, burst, clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()  # how much there was, and when

    def consume_or_wait_s(self, key: str) -> float:
        """Consume a token of the client `key` and return 0, or return the time to wait for the next token."""
        now = self._clock()
        left, at_s = self._buckets.pop(key, (self._burst, now))
        left = min(left + (now - at_s) * self._rate_per_s, self._burst)
        allowed = left >= 1.0
        self._buckets[key] = (left - allowed, now)
        if len(self._buckets) > MAX_CLIENTS:
            self._buckets.popitem(last=False)
        return 0.0 if allowed else (1.0 - left) / self._rate_per_s
