"""Routes to sign a browser in and out."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Body, Request, Response

from app.api.dependencies import AuthenticatorDep
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.http.request_origin import is_encrypted
from app.messages.people import SessionInfo, SignIn
from app.people.authenticator import Authenticator, session_cookie_name
from app.people.authorization import PUBLIC_ROUTE, AuthenticatedUser, get_user
from app.people.tokens import hash_secret

router = APIRouter(prefix="/api/session", tags=["session"])
NO_TOKENS_TEXT = (
    "This service has no tokens: nobody needs to sign in. Make them with `graspwatch token add NAME --role ROLE`."
)


@router.get("", dependencies=[PUBLIC_ROUTE])
async def get_session(request: Request, authenticator: AuthenticatorDep) -> SessionInfo:
    """Return who sends the request, and whether signing in is needed."""
    return _build_session_info(authenticator, get_user(request))


@router.post(
    "",
    dependencies=[PUBLIC_ROUTE],
    responses={
        401: {"description": "The token is not good", **PROBLEM_RESPONSE},
        409: {"description": "There are no tokens", **PROBLEM_RESPONSE},
        429: {"description": "Too many wrong ones", **PROBLEM_RESPONSE},
    },
)
async def sign_in(
    request: Request, authenticator: AuthenticatorDep, response: Response, body: Annotated[SignIn, Body()]
) -> SessionInfo:
    """Exchange a token for a session cookie. Programs need no cookie: they send the token with each request."""
    if not authenticator.token_store.requires_token:
        raise ProblemError(HTTPStatus.CONFLICT, NO_TOKENS_TEXT)
    entry = authenticator.check_token(request, body.token.strip())
    _end_browser_session(request, authenticator)
    secret = authenticator.browser_sessions.begin(entry.sha256)
    encrypted = is_encrypted(request, authenticator.server_settings)
    response.set_cookie(session_cookie_name(request), secret, httponly=True, samesite="strict", secure=encrypted)
    authenticator.write_access_entry(f"Signed in as {entry.role.value}", entry.name)
    return _build_session_info(
        authenticator, AuthenticatedUser(entry.role, entry.name, entry.sha256, hash_secret(secret))
    )


@router.delete("", status_code=HTTPStatus.NO_CONTENT, dependencies=[PUBLIC_ROUTE])
async def sign_out(request: Request, authenticator: AuthenticatorDep, response: Response) -> None:
    """End this browser's session and close its open connections."""
    _end_browser_session(request, authenticator)
    response.delete_cookie(session_cookie_name(request), httponly=True, samesite="strict")


def _end_browser_session(request: Request, authenticator: Authenticator) -> None:
    user = get_user(request)
    if user and user.session_hash:
        authenticator.browser_sessions.end(user.session_hash)
        authenticator.close_unauthorized()
        authenticator.write_access_entry("Signed out", user.name)


def _build_session_info(authenticator: Authenticator, user: AuthenticatedUser | None) -> SessionInfo:
    return SessionInfo(
        needed=authenticator.token_store.requires_token,
        name=user.name if user else None,
        role=user.role if user else None,
    )
