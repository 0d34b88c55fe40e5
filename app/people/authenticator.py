"""The class Authenticator: finds the user of each request, limits rates, and closes WebSockets without permission."""

import asyncio
import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from http import HTTPStatus

from starlette.requests import HTTPConnection

from app.http.methods import SAFE_METHODS
from app.http.problems import ProblemError
from app.http.rate_limiter import RateLimiter
from app.http.request_origin import is_allowed_host, is_local_request, is_same_origin, requested_host, single_header
from app.messages.journal import JournalKind
from app.messages.people import Role
from app.people.authorization import AuthenticatedUser
from app.people.browser_sessions import BrowserSessions
from app.people.tokens import TokenEntry, TokenStore, hash_secret
from app.service.tool_service import ToolService
from config.service_plan import ServicePlan
from estimator.force_alarms import Priority

WATCH_PERIOD_S = 0.5
FAILURE_BURST, FAILURES_PER_S = 10, 1 / 6
STOP_PATH = re.compile(r"/api/(runs/[^/]+/)?stop")
LOCAL_ONLY_TEXT = (
    "This service has no tokens, so it answers only this computer: at localhost or its own address, not through a "
    "proxy and not for a page of another site. Open it at localhost, or make tokens with "
    "`graspwatch token add NAME --role ROLE` to be let in from elsewhere."
)
WRONG_HOST_TEXT = (
    "The name by which this service was asked (`Host`) is not well formed, or is none of its own, and nothing was "
    "done. Ask by its address, or have the name added to server.hosts in its settings."
)
SIGN_IN_TEXT = "Sign in on the dashboard, or send a good token as `Authorization: Bearer TOKEN`."
FOREIGN_ORIGIN_TEXT = "The page that asks is not of this service (its `Origin`), and only its own pages may do that."
CHALLENGE_HEADERS = {"WWW-Authenticate": 'Bearer realm="Graspwatch"'}


@dataclass(eq=False, slots=True)
class OpenWebSocket:
    """An open WebSocket and its user."""

    user: AuthenticatedUser
    task: asyncio.Task[object]
    close_requested: bool = False


class Authenticator:
    """Finder of each request's user; refuses requests that are unknown, from a foreign page or too frequent."""

    def __init__(self, plan: ServicePlan) -> None:
        """Raise ConfigurationError if other users may access the file of tokens, or it cannot be read."""
        self.server_settings = server = plan.settings.server
        self.token_store = TokenStore(plan.data_folder)
        self.browser_sessions = BrowserSessions(plan.settings.people.session_idle_s)
        self.open_websockets: set[OpenWebSocket] = set()
        self._request_limiter = RateLimiter(server.requests_per_s, server.burst_requests)
        self._failure_limiter = RateLimiter(FAILURES_PER_S, FAILURE_BURST)
        self._tool_service: ToolService | None = None

    # --- on each request ---------------------------------------------------------------------------------------------

    def authenticate(self, connection: HTTPConnection, is_public: bool) -> AuthenticatedUser | None:
        """Return the user of a request; None only where the path `is_public`.

        Raises:
            ProblemError: the user is unknown, `Host` or `Origin` is not allowed, or the requests come too often.
        """
        user = self._find_user(connection)
        method = connection.scope.get("method", "WEBSOCKET")
        stops = method == "POST" and STOP_PATH.fullmatch(connection.scope["path"])
        if not stops:
            self._limit_request_rate(connection, user)
        if user is None and not is_public:
            if stops:  # a refused stop counts, or it could fill the journal
                self._limit_rate_of(f"address {client_address(connection)}")
            if self.token_store.requires_token:
                raise ProblemError(HTTPStatus.UNAUTHORIZED, SIGN_IN_TEXT, headers=CHALLENGE_HEADERS)
            raise ProblemError(HTTPStatus.FORBIDDEN, LOCAL_ONLY_TEXT)
        asked = requested_host(connection)
        if asked is None or (
            self.server_settings.hosts and not is_allowed_host(asked, connection, self.server_settings.hosts)
        ):
            raise ProblemError(HTTPStatus.FORBIDDEN, WRONG_HOST_TEXT)
        if method not in SAFE_METHODS:
            own = is_same_origin(connection)
            if own is False or (own is None and user and user.session_hash):
                self._limit_rate_of(f"address {client_address(connection)}")  # a local user is not counted above
                raise ProblemError(HTTPStatus.FORBIDDEN, FOREIGN_ORIGIN_TEXT)
        return user

    def _find_user(self, connection: HTTPConnection) -> AuthenticatedUser | None:
        self._reload_tokens()
        if not self.token_store.requires_token:
            return AuthenticatedUser(Role.ADMIN) if is_local_request(connection, self.server_settings.hosts) else None
        if "authorization" in connection.headers:
            scheme, _, token = (single_header(connection, "authorization") or "").partition(" ")
            if scheme.lower() != "bearer":
                return None
            entry = self.check_token(connection, token.strip())
            return AuthenticatedUser(entry.role, entry.name, entry.sha256)
        secret = connection.cookies.get(session_cookie_name(connection))
        if not secret:
            return None
        key = hash_secret(secret)
        entry = self.token_store.find_by_hash(self.browser_sessions.find_token_hash(key) or "")
        if entry is None:
            return None
        self.browser_sessions.touch(key)
        return AuthenticatedUser(entry.role, entry.name, entry.sha256, key)

    def check_token(self, connection: HTTPConnection, token: str) -> TokenEntry:
        """Return the entry of a valid token.

        Wrong tokens are counted and written to the journal. A valid one is accepted whatever came before it, so that
        wrong tokens cannot lock other users out.

        Raises:
            ProblemError: the token is not valid, or too many wrong tokens came from this address.
        """
        entry = self.token_store.find_by_token(token)
        if entry:
            return entry
        where = client_address(connection)
        if wait_s := self._failure_limiter.consume_or_wait_s(where):
            raise ProblemError(
                HTTPStatus.TOO_MANY_REQUESTS,
                "Too many wrong tokens came from this address.",
                headers={"Retry-After": str(int(wait_s) + 1)},
            )
        self.write_access_entry(f"A token that is not good came from {where}")
        detail = f"This token is wrong, expired or taken back. {SIGN_IN_TEXT}"
        raise ProblemError(HTTPStatus.UNAUTHORIZED, detail, headers=CHALLENGE_HEADERS)

    def _limit_request_rate(self, connection: HTTPConnection, user: AuthenticatedUser | None) -> None:
        if user and user.name is None:
            return  # a local user has simpler ways to keep the computer busy
        self._limit_rate_of(f"person {user.name}" if user else f"address {client_address(connection)}")

    def _limit_rate_of(self, key: str) -> None:
        if wait_s := self._request_limiter.consume_or_wait_s(key):
            raise ProblemError(
                HTTPStatus.TOO_MANY_REQUESTS,
                "Too many requests: ask less often. STOP is always taken.",
                headers={"Retry-After": str(int(wait_s) + 1)},
            )

    # --- in the background -------------------------------------------------------------------------------------------

    async def watch_token_file(self, tool_service: ToolService) -> None:
        """Reload the file of tokens when it changes, until canceled; open WebSockets keep their sessions alive."""
        self._tool_service = tool_service
        while True:
            self._reload_tokens()
            for each in self.open_websockets:
                if each.user.session_hash:
                    self.browser_sessions.touch(each.user.session_hash)
            self.close_unauthorized()
            await asyncio.sleep(WATCH_PERIOD_S)

    def close_unauthorized(self) -> None:
        """Close the WebSockets of users whose token or session is no longer valid."""
        for each in [
            each
            for each in self.open_websockets
            if not each.close_requested and not self._is_still_authorized(each.user)
        ]:
            each.close_requested = True
            each.task.cancel()

    def _is_still_authorized(self, user: AuthenticatedUser) -> bool:
        if user.token_hash is None:
            return not self.token_store.requires_token
        in_session = user.session_hash is None or self.browser_sessions.find_token_hash(user.session_hash) is not None
        return in_session and self.token_store.find_by_hash(user.token_hash) is not None

    @contextlib.contextmanager
    def track_websocket(self, user: AuthenticatedUser, task: "asyncio.Task[object]") -> Iterator[OpenWebSocket]:
        attendance = OpenWebSocket(user, task)
        self.open_websockets.add(attendance)
        try:
            yield attendance
        finally:
            self.open_websockets.discard(attendance)

    def _reload_tokens(self) -> None:
        """Reload a changed file; write new and revoked tokens to the journal, and update the alarm about the file."""
        before = self.token_store.entries
        if not self.token_store.reload_if_changed():
            return
        known = {entry.sha256: entry for entry in before}
        for entry in self.token_store.entries:
            if entry.sha256 not in known:
                self.write_access_entry(f"{entry.name} has a token ({entry.role.value})")
            elif entry.revoked_at and not known[entry.sha256].revoked_at:
                self.write_access_entry(f"The token of {entry.name} ({entry.role.value}) was taken back")
                if self._tool_service:
                    self._tool_service.release_control(entry.name)
        if self._tool_service:
            self._tool_service.alarms.update_technical("people", Priority.MEDIUM, self.token_store.fault)
        self.close_unauthorized()

    def write_access_entry(self, text: str, by: str | None = None) -> None:
        """Write a journal line about access; viewers of the live stream do not receive it."""
        if self._tool_service:
            self._tool_service.journal.write(JournalKind.ACCESS, text, by=by)


def client_address(connection: HTTPConnection) -> str:
    return connection.client.host if connection.client else "nowhere"


def session_cookie_name(connection: HTTPConnection) -> str:
    """Return the cookie's name. It holds the port, because browsers send cookies to all ports of a host."""
    return f"graspwatch-{connection.scope['server'][1]}"
