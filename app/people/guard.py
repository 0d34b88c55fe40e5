"""Tells who asks, whether he may from where he is, and how often; ends what he has open once he may not any more."""

import asyncio
import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from http import HTTPStatus

from starlette.requests import HTTPConnection

from app.people.origin import asked_host, comes_from_here, is_allowed, is_of_this_site, only
from app.people.rates import Rates
from app.people.roles import SAFE_METHODS, Who
from app.people.sessions import Sessions
from app.people.tokens import Entry, People, digest
from app.plan import ServicePlan
from app.problems import ProblemError
from app.station import Station
from app.wire import JournalKind, Priority, Role

WATCH_S = 0.5
FAILURES_AT_ONCE, FAILURES_PER_S = 10, 1 / 6
STOP = re.compile(r"/api/(runs/[^/]+/)?stop")
HOW_HERE = (
    "This service has no tokens, so it answers only this computer: at localhost or its own address, not through a "
    "proxy and not for a page of another site. Open it at localhost, or make tokens with "
    "`graspwatch token add NAME --role ROLE` to be let in from elsewhere."
)
OTHER_HOST = (
    "The name by which this service was asked (`Host`) is not well formed, or is none of its own, and nothing was "
    "done. Ask by its address, or have the name added to server.hosts in its settings."
)
HOW_BY_TOKEN = "Sign in on the dashboard, or send a good token as `Authorization: Bearer TOKEN`."
FOREIGN_PAGE = "The page that asks is not of this service (its `Origin`), and only its own pages may do that."
CHALLENGE = {"WWW-Authenticate": 'Bearer realm="Graspwatch"'}


@dataclass(eq=False, slots=True)
class Attendance:
    """Somebody's open WebSocket."""

    who: Who
    task: asyncio.Task[object]
    ended: bool = False


class Guard:
    """One for a service."""

    def __init__(self, plan: ServicePlan) -> None:
        """Raises ConfigurationError: the file of people is at fault."""
        self.server = server = plan.settings.server
        self.people = People(plan.data)
        self.sessions = Sessions(plan.settings.people.session_idle_s)
        self.open: set[Attendance] = set()
        self._rates = Rates(server.requests_per_s, server.burst_requests)
        self._failures = Rates(FAILURES_PER_S, FAILURES_AT_ONCE)
        self._station: Station | None = None

    # --- at the gate -------------------------------------------------------------------------------------------------

    def admit(self, connection: HTTPConnection, is_open: bool) -> Who | None:
        """Who asks; None only where the address `is_open` to everybody.

        Raises:
            ProblemError: he is not let in, comes from another site's page, or asks too often.
        """
        who = self._who(connection)
        method = connection.scope.get("method", "WEBSOCKET")
        stops = method == "POST" and STOP.fullmatch(connection.scope["path"])
        if not stops:
            self._count(connection, who)
        if who is None and not is_open:
            if stops:  # one that is refused; else it could fill the journal
                self._count_as(f"address {address_of(connection)}")
            if self.people.guarded:
                raise ProblemError(HTTPStatus.UNAUTHORIZED, HOW_BY_TOKEN, headers=CHALLENGE)
            raise ProblemError(HTTPStatus.FORBIDDEN, HOW_HERE)
        asked = asked_host(connection)
        if asked is None or (self.server.hosts and not is_allowed(asked, connection, self.server.hosts)):
            raise ProblemError(HTTPStatus.FORBIDDEN, OTHER_HOST)
        if method not in SAFE_METHODS:
            own = is_of_this_site(connection)
            if own is False or (own is None and who and who.session):
                self._count_as(f"address {address_of(connection)}")  # whoever has no token is not counted above
                raise ProblemError(HTTPStatus.FORBIDDEN, FOREIGN_PAGE)
        return who

    def _who(self, connection: HTTPConnection) -> Who | None:
        self._refresh()
        if not self.people.guarded:
            return Who(Role.ADMIN) if comes_from_here(connection, self.server.hosts) else None
        if "authorization" in connection.headers:
            scheme, _, token = (only(connection, "authorization") or "").partition(" ")
            if scheme.lower() != "bearer":
                return None
            entry = self.check(connection, token.strip())
            return Who(entry.role, entry.name, entry.sha256)
        secret = connection.cookies.get(cookie_of(connection))
        if not secret:
            return None
        key = digest(secret)
        entry = self.people.of(self.sessions.token_of(key) or "")
        if entry is None:
            return None
        self.sessions.use(key)
        return Who(entry.role, entry.name, entry.sha256, key)

    def check(self, connection: HTTPConnection, token: str) -> Entry:
        """Whose token it is. Wrong ones are counted and told; a good one is taken whatever came before it, so that
        nobody can lock others out.

        Raises:
            ProblemError: it is not good; and, after too many of those, how long to wait.
        """
        entry = self.people.find(token)
        if entry:
            return entry
        where = address_of(connection)
        if wait_s := self._failures.wait_s(where):
            raise ProblemError(
                HTTPStatus.TOO_MANY_REQUESTS,
                "Too many wrong tokens came from this address.",
                headers={"Retry-After": str(int(wait_s) + 1)},
            )
        self.note(f"A token that is not good came from {where}")
        detail = f"This token is wrong, expired or taken back. {HOW_BY_TOKEN}"
        raise ProblemError(HTTPStatus.UNAUTHORIZED, detail, headers=CHALLENGE)

    def _count(self, connection: HTTPConnection, who: Who | None) -> None:
        if who and who.name is None:
            return  # whoever sits at the machine has simpler ways to keep it busy
        self._count_as(f"person {who.name}" if who else f"address {address_of(connection)}")

    def _count_as(self, key: str) -> None:
        if wait_s := self._rates.wait_s(key):
            raise ProblemError(
                HTTPStatus.TOO_MANY_REQUESTS,
                "Too many requests: ask less often. STOP is always taken.",
                headers={"Retry-After": str(int(wait_s) + 1)},
            )

    # --- meanwhile ---------------------------------------------------------------------------------------------------

    async def watch(self, station: Station) -> None:
        """Notice what changes in the file of people, until cancelled."""
        self._station = station
        while True:
            self._refresh()
            for each in self.open:
                if each.who.session:
                    self.sessions.use(each.who.session)
            self.end_gone()
            await asyncio.sleep(WATCH_S)

    def end_gone(self) -> None:
        """Close the WebSockets of those who may not be here any more."""
        for each in [each for each in self.open if not each.ended and not self._may_stay(each.who)]:
            each.ended = True
            each.task.cancel()

    def _may_stay(self, who: Who) -> bool:
        if who.token is None:
            return not self.people.guarded
        in_session = who.session is None or self.sessions.token_of(who.session) is not None
        return in_session and self.people.of(who.token) is not None

    @contextlib.contextmanager
    def attending(self, who: Who, task: "asyncio.Task[object]") -> Iterator[Attendance]:
        attendance = Attendance(who, task)
        self.open.add(attendance)
        try:
            yield attendance
        finally:
            self.open.discard(attendance)

    def _refresh(self) -> None:
        """Where the file is another one: tell what it says now."""
        before = self.people.entries
        if not self.people.refresh():
            return
        known = {entry.sha256: entry for entry in before}
        for entry in self.people.entries:
            if entry.sha256 not in known:
                self.note(f"{entry.name} has a token ({entry.role.value})")
            elif entry.revoked_at and not known[entry.sha256].revoked_at:
                self.note(f"The token of {entry.name} ({entry.role.value}) was taken back")
                if self._station:
                    self._station.give_back_control(entry.name)
        if self._station and self.people.fault:
            self._station.alarms.raise_technical("people", Priority.MEDIUM, self.people.fault)
        elif self._station:
            self._station.alarms.end("people")
        self.end_gone()

    def note(self, text: str, by: str | None = None) -> None:
        """A line in the journal; it is not news for those who watch the tissue."""
        if self._station:
            self._station.journal.write(JournalKind.ACCESS, text, by=by)


def address_of(connection: HTTPConnection) -> str:
    return connection.client.host if connection.client else "nowhere"


def cookie_of(connection: HTTPConnection) -> str:
    """The cookie's name; browsers tell services of one machine apart by it, as they do not look at ports."""
    return f"graspwatch-{connection.scope['server'][1]}"
