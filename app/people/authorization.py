"""The authenticated user of a request, and the role that every route declares."""

from dataclasses import dataclass, field
from http import HTTPStatus

from fastapi import Depends, params
from starlette.requests import HTTPConnection

from app.http.problems import ProblemError
from app.messages.people import Role


@dataclass(frozen=True, slots=True)
class AuthenticatedUser:
    """A user with a role. Without a name, it is a local user of a service that has no tokens.

    `token_hash` and `session_hash` identify the token and the browser session; None if there is none.
    """

    role: Role
    name: str | None = None
    token_hash: str | None = field(default=None, repr=False)
    session_hash: str | None = field(default=None, repr=False)


class RoleRequirement:
    """A route's dependency that demands a role; None: the route is public."""

    def __init__(self, role: Role | None) -> None:
        self.role = role

    async def __call__(self, connection: HTTPConnection) -> None:
        if self.role is not None:
            check_role(connection, self.role)


def check_role(connection: HTTPConnection, role: Role) -> None:
    """Check that the user of a request has a role.

    Raises:
        ProblemError: the user is unknown, or has less rights.
    """
    user = get_user(connection)
    if user is None:  # AuthMiddleware refused the user, unless the path is public for another method
        raise ProblemError(HTTPStatus.UNAUTHORIZED, "Sign in first.")
    if not user.role.includes(role):
        detail = (
            f"{user.name} is {_with_article(user.role)}, and this needs {_with_article(role)}. Ask an admin of this "
            f"service for a token made with `graspwatch token add NAME --role {role.value}`."
        )
        raise ProblemError(HTTPStatus.FORBIDDEN, detail)


PUBLIC_ROUTE = Depends(RoleRequirement(None))


def require_role(role: Role) -> params.Depends:
    """Return the dependency for a route: `dependencies=[require_role(Role.OPERATOR)]`."""
    return Depends(RoleRequirement(role))


def get_user(connection: HTTPConnection) -> AuthenticatedUser | None:
    """Return the user of a request, None if unknown."""
    return connection.state.user


def requester_name(connection: HTTPConnection, by: str | None) -> str | None:
    """Return the name of the signed-in user, else the name `by` from the request."""
    user = get_user(connection)
    return user.name if user and user.name else by


def require_requester_name(connection: HTTPConnection, by: str | None) -> str:
    """Return the requester's name, where an action needs one.

    Raises:
        ProblemError: the request has no name.
    """
    name = requester_name(connection, by)
    if name is None:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, "Say in `by` who does this.", "by")
    return name


def _with_article(role: Role) -> str:
    return f"{'a' if role is Role.VIEWER else 'an'} {role.value}"
