"""Before every route: nobody passes who is not known, and nothing that is too large or too slow."""

import asyncio
import contextlib
from collections.abc import Collection
from http import HTTPStatus

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from app.http.problems import ProblemError
from app.people.authenticator import STOP_PATH, Authenticator
from app.people.authorization import AuthenticatedUser

BODY_TIMEOUT_S = 10.0  # for a request's body to come
SIGNED_OUT_CLOSE_CODE = 4401  # code of a close
PROTECTED_PATHS = ("/api/", "/metrics", "/openapi.json", "/docs", "/redoc", "/static-offline-docs")
BODY_TOO_LARGE_TEXT = "The request's body is larger than server.most_body_bytes allows."


class AuthMiddleware:
    """ASGI middleware. All of `GUARDED` is closed to strangers, except what is `open_paths`; the rest is the dashboard,
    which has to be there for somebody to sign in."""

    def __init__(
        self, app: ASGIApp, authenticator: Authenticator, public_paths: Collection[str], max_body_bytes: int
    ) -> None:
        self._app, self._authenticator = app, authenticator
        self._public_paths, self._max_body_bytes = frozenset(public_paths), max_body_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        try:
            path = scope["path"]
            who = self._authenticator.authenticate(
                HTTPConnection(scope), path in self._public_paths or not path.startswith(PROTECTED_PATHS)
            )
            scope.setdefault("state", {})["who"] = who
            if scope["type"] == "http":
                if not STOP_PATH.fullmatch(path):  # which is obeyed before its body is read
                    self._check_length(Headers(scope=scope))
                await self._app(scope, self._limit_body(receive), send)
                return
        except ProblemError as error:
            await _refuse(error, scope, receive, send)
            return
        await self._serve_websocket(who, scope, receive, send)

    def _check_length(self, headers: Headers) -> None:
        """
        Raises:
            ProblemError: the header tells a body of more than is allowed.
        """
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > self._max_body_bytes:
            raise ProblemError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, BODY_TOO_LARGE_TEXT)

    def _limit_body(self, receive: Receive) -> Receive:
        """`receive` for a body of no more than is allowed, whatever its header says."""
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
            if received > self._max_body_bytes:
                raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, BODY_TOO_LARGE_TEXT)
            return message

        return bounded

    async def _serve_websocket(
        self, user: AuthenticatedUser | None, scope: Scope, receive: Receive, send: Send
    ) -> None:
        """A WebSocket, closed as soon as whoever opened it may not be here any more."""
        task = asyncio.current_task()
        if user is None or task is None:
            await self._app(scope, receive, send)  # an open one; its route says so
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


async def _refuse(error: ProblemError, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "http":
        await error.response()(scope, receive, send)
    else:
        await WebSocket(scope, receive, send).send_denial_response(error.response())
