"""Sessions of browsers: kept here, so that they can be ended here. A browser only has the random name of its own."""

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass

from app.people.tokens import digest

SECRET_BYTES = 32
MOST_OF_ONE = 20  # sessions by one token; the one unused for longest goes


@dataclass(slots=True)
class _Session:
    token: str
    used_s: float


class Sessions:
    """By the hash of their secret, to the hash of the token with which they began."""

    def __init__(self, idle_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._idle_s, self._clock = idle_s, clock
        self._sessions: dict[str, _Session] = {}

    def begin(self, token_hash: str) -> str:
        """The secret of a new one."""
        self._forget_idle()
        mine = [key for key, session in self._sessions.items() if session.token == token_hash]
        if len(mine) >= MOST_OF_ONE:
            del self._sessions[min(mine, key=lambda key: self._sessions[key].used_s)]
        secret = secrets.token_urlsafe(SECRET_BYTES)
        self._sessions[digest(secret)] = _Session(token_hash, self._clock())
        return secret

    def token_of(self, key: str) -> str | None:
        """None: there is no such session, or not any more."""
        session = self._sessions.get(key)
        return session.token if session and self._clock() - session.used_s <= self._idle_s else None

    def use(self, key: str) -> None:
        """Somebody is there."""
        if self.token_of(key):
            self._sessions[key].used_s = self._clock()

    def end(self, key: str) -> None:
        self._sessions.pop(key, None)

    def _forget_idle(self) -> None:
        for key in [key for key in self._sessions if self.token_of(key) is None]:
            del self._sessions[key]
