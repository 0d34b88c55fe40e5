"""Who asks, and what every route declares: the role that it needs."""

from dataclasses import dataclass, field
from http import HTTPStatus

from fastapi import Depends
from starlette.requests import HTTPConnection

from app.http.methods import SAFE_METHODS
from app.http.problems import ProblemError
from app.messages.wire import Role


@dataclass(frozen=True, slots=True)
class AuthenticatedUser:
    """Somebody who may be here. No name: whoever sits at this machine, of a service that has no tokens.

    `token` and `session` are the hashes by which he came, None where there is none.
    """

    role: Role
    name: str | None = None
    token_hash: str | None = field(default=None, repr=False)
    session_hash: str | None = field(default=None, repr=False)


class RoleRequirement:
    """A route's dependency; `role` None: it is open to everybody."""

    def __init__(self, role: Role | None) -> None:
        self.role = role

    async def __call__(self, connection: HTTPConnection) -> None:
        who = get_user(connection)
        if self.role is None:
            return
        if who is None:  # the gate has refused him already, unless a route's address is open and the route is not
            raise ProblemError(HTTPStatus.UNAUTHORIZED, "Sign in first.")
        if not who.role.includes(self.role):
            detail = (
                f"{who.name} is {_with_article(who.role)}, and this needs "
                f"{_with_article(self.role)}. Ask an admin of this service for a "
                f"token made with `graspwatch token add NAME --role {self.role.value}`."
            )
            raise ProblemError(HTTPStatus.FORBIDDEN, detail)
        if who.name and connection.scope.get("method", "GET") not in SAFE_METHODS:
            connection.app.state.station.control_lease.renew(who.name)


PUBLIC_ROUTE = Depends(RoleRequirement(None))


def require_role(role: Role) -> object:
    """What stands beside every route: `dependencies=[needs(Role.OPERATOR)]`."""
    return Depends(RoleRequirement(role))


def get_user(connection: HTTPConnection) -> AuthenticatedUser | None:
    """None: nobody who is known."""
    return connection.state.who


def requester_name(connection: HTTPConnection, by: str | None) -> str | None:
    """In whose name something is done: of whoever is signed in, else as he says himself."""
    who = get_user(connection)
    return who.name if who and who.name else by


def require_requester_name(connection: HTTPConnection, by: str | None) -> str:
    """The same, where somebody has to stand for it.

    Raises:
        ProblemError: there is no name.
    """
    name = requester_name(connection, by)
    if name is None:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, "Say in `by` who does this.", "by")
    return name


def _with_article(role: Role) -> str:
    return f"{'a' if role is Role.VIEWER else 'an'} {role.value}"
