"""The class BrowserSessions: the server keeps the sessions and can end them; a browser only has a secret."""

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass

from app.people.tokens import hash_secret

SECRET_BYTES = 32
MAX_SESSIONS_PER_TOKEN = 20  # beyond that, the session unused for longest ends


@dataclass(slots=True)
class _BrowserSession:
    token_hash: str
    last_used_s: float


class BrowserSessions:
    """The open sessions. The key of a session is the hash of its secret; it leads to the hash of its token."""

    def __init__(self, idle_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._idle_s, self._clock = idle_s, clock
        self._sessions: dict[str, _BrowserSession] = {}

    def begin(self, token_hash: str) -> str:
        """Begin a session and return its secret."""
        self._remove_idle()
        mine = [key for key, session in self._sessions.items() if session.token_hash == token_hash]
        if len(mine) >= MAX_SESSIONS_PER_TOKEN:
            del self._sessions[min(mine, key=lambda key: self._sessions[key].last_used_s)]
        secret = secrets.token_urlsafe(SECRET_BYTES)
        self._sessions[hash_secret(secret)] = _BrowserSession(token_hash, self._clock())
        return secret

    def find_token_hash(self, key: str) -> str | None:
        """Return the token hash of a session; None if the session is unknown or expired."""
        session = self._sessions.get(key)
        return session.token_hash if session and self._clock() - session.last_used_s <= self._idle_s else None

    def touch(self, key: str) -> None:
        """Renew a session that is in use."""
        if self.find_token_hash(key):
            self._sessions[key].last_used_s = self._clock()

    def end(self, key: str) -> None:
        self._sessions.pop(key, None)

    def _remove_idle(self) -> None:
        for key in [key for key in self._sessions if self.find_token_hash(key) is None]:
            del self._sessions[key]
