"""The class AuthMiddleware, before every route: refuses unknown users, and bodies that are too large or too slow."""

import asyncio
import contextlib
from collections.abc import Collection, Mapping
from http import HTTPStatus

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from app.http.problems import ProblemError
from app.people.authenticator import STOP_PATH, Authenticator
from app.people.authorization import AuthenticatedUser

BODY_TIMEOUT_S = 10.0  # for each part of a request's body to arrive
SIGNED_OUT_CLOSE_CODE = 4401
PROTECTED_PATHS = ("/api/", "/metrics", "/openapi.json", "/docs", "/redoc", "/static-offline-docs")
BODY_TOO_LARGE_TEXT = "The request's body is larger than {} bytes, the most that is accepted here. Send less."


class AuthMiddleware:
    """ASGI middleware that authenticates requests to PROTECTED_PATHS, except those in `public_paths`.

    All other paths belong to the dashboard, which a user needs for signing in.
    """

    def __init__(
        self,
        app: ASGIApp,
        authenticator: Authenticator,
        public_paths: Collection[str],
        max_body_bytes: int,
        max_upload_bytes: Mapping[str, int],
    ) -> None:
        """Take the application; `max_upload_bytes` are the limits of paths that accept files, by path."""
        self._app, self._authenticator = app, authenticator
        self._public_paths, self._max_body_bytes = frozenset(public_paths), max_body_bytes
        self._max_upload_bytes = max_upload_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        try:
            path = scope["path"]
            user = self._authenticator.authenticate(
                HTTPConnection(scope), path in self._public_paths or not path.startswith(PROTECTED_PATHS)
            )
            scope.setdefault("state", {})["user"] = user
            if scope["type"] == "http":
                if not STOP_PATH.fullmatch(path):  # a stop takes effect before its body is read
                    _check_length(Headers(scope=scope), self._find_max_bytes(path))
                await self._app(scope, _limit_body(receive, self._find_max_bytes(path)), send)
                return
        except ProblemError as error:
            await _refuse(error, scope, receive, send)
            return
        await self._serve_websocket(user, scope, receive, send)

    def _find_max_bytes(self, path: str) -> int:
        return max(self._max_body_bytes, self._max_upload_bytes.get(path, 0))

    async def _serve_websocket(
        self, user: AuthenticatedUser | None, scope: Scope, receive: Receive, send: Send
    ) -> None:
        """Serve a WebSocket, and close it as soon as its user is no longer permitted."""
        task = asyncio.current_task()
        if user is None or task is None:
            await self._app(scope, receive, send)  # a public route
            return
        with self._authenticator.track_websocket(user, task) as attendance:
            try:
                await self._app(scope, receive, send)
            except asyncio.CancelledError:
                if not attendance.close_requested:
                    raise
                task.uncancel()
                with contextlib.suppress(RuntimeError, OSError):  # it is closed already
                    await send({"type": "websocket.close", "code": SIGNED_OUT_CLOSE_CODE, "reason": "signed out"})


def _check_length(headers: Headers, max_bytes: int) -> None:
    """Raise ProblemError if the header announces a body that is too large."""
    length = headers.get("content-length", "0")
    if not length.isdecimal() or int(length) > max_bytes:
        raise ProblemError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, BODY_TOO_LARGE_TEXT.format(max_bytes))


def _limit_body(receive: Receive, max_bytes: int) -> Receive:
    """Return a `receive` that limits the size of the body, whatever its header says, and the wait for it."""
    received, whole = 0, False

    async def bounded() -> Message:
        nonlocal received, whole
        if whole:
            return await receive()
        try:
            message = await asyncio.wait_for(receive(), BODY_TIMEOUT_S)
        except TimeoutError:
            raise HTTPException(HTTPStatus.REQUEST_TIMEOUT, "The request's body did not come. Ask again.") from None
        whole = not message.get("more_body", False)
        received += len(message.get("body", b""))
        if received > max_bytes:
            raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, BODY_TOO_LARGE_TEXT.format(max_bytes))
        return message

    return bounded


async def _refuse(error: ProblemError, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "http":
        await error.response()(scope, receive, send)
    else:
        await WebSocket(scope, receive, send).send_denial_response(error.response())
