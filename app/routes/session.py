"""Signing in and out of a browser."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Body, Request, Response

from app.people.guard import Guard, cookie_of
from app.people.origin import is_encrypted
from app.people.roles import ANYBODY, Who, who_asks
from app.people.tokens import digest
from app.problems import PROBLEM, ProblemError
from app.wire import SessionInfo, SignIn

router = APIRouter(prefix="/api/session", tags=["session"])
NO_NEED = "This service has no tokens: nobody needs to sign in. Make them with `graspwatch token add NAME --role ROLE`."


@router.get("", dependencies=[ANYBODY])
async def session(request: Request) -> SessionInfo:
    """Who asks, and whether signing in is needed."""
    return _info(_guard(request), who_asks(request))


@router.post(
    "",
    dependencies=[ANYBODY],
    responses={
        401: {"description": "The token is not good", **PROBLEM},
        409: {"description": "There are no tokens", **PROBLEM},
        429: {"description": "Too many wrong ones", **PROBLEM},
    },
)
async def sign_in(request: Request, response: Response, wanted: Annotated[SignIn, Body()]) -> SessionInfo:
    """Exchange a token for a cookie. Programs do not need one: they send the token with each request."""
    guard = _guard(request)
    if not guard.people.guarded:
        raise ProblemError(HTTPStatus.CONFLICT, NO_NEED)
    entry = guard.check(request, wanted.token.strip())
    _end(request)
    secret = guard.sessions.begin(entry.sha256)
    encrypted = is_encrypted(request, guard.server)
    response.set_cookie(cookie_of(request), secret, httponly=True, samesite="strict", secure=encrypted)
    guard.note(f"Signed in as {entry.role.value}", entry.name)
    return _info(guard, Who(entry.role, entry.name, entry.sha256, digest(secret)))


@router.delete("", status_code=HTTPStatus.NO_CONTENT, dependencies=[ANYBODY])
async def sign_out(request: Request, response: Response) -> None:
    """End this browser's session, with all that it has open."""
    _end(request)
    response.delete_cookie(cookie_of(request), httponly=True, samesite="strict")


def _end(request: Request) -> None:
    """The session that the request came with, if any."""
    guard, who = _guard(request), who_asks(request)
    if who and who.session:
        guard.sessions.end(who.session)
        guard.end_gone()
        guard.note("Signed out", who.name)


def _info(guard: Guard, who: Who | None) -> SessionInfo:
    return SessionInfo(needed=guard.people.guarded, name=who.name if who else None, role=who.role if who else None)


def _guard(request: Request) -> Guard:
    return request.app.state.guard
