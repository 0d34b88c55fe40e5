"""How often somebody may ask."""

import time
from collections import OrderedDict
from collections.abc import Callable

MAX_CLIENTS = 10_000  # of those who ask: whoever has not asked for longest is forgotten first, and had his burst again


class RateLimiter:
    """A bucket of tokens for each who asks: it holds `burst` and gets `per_s` anew."""

    def __init__(self, rate_per_s: float, burst: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate_per_s, self._burst, self._clock = rate_per_s, burst, clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()  # how much there was, and when

    def consume_or_wait_s(self, key: str) -> float:
        """0: he may, and it is counted. Otherwise how long he has to wait."""
        now = self._clock()
        left, at_s = self._buckets.pop(key, (self._burst, now))
        left = min(left + (now - at_s) * self._rate_per_s, self._burst)
        allowed = left >= 1.0
        self._buckets[key] = (left - allowed, now)
        if len(self._buckets) > MAX_CLIENTS:
            self._buckets.popitem(last=False)
        return 0.0 if allowed else (1.0 - left) / self._rate_per_s
