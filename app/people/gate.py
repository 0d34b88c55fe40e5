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

from app.people.guard import STOP, Guard
from app.people.roles import Who
from app.problems import ProblemError

BODY_S = 10.0  # for a request's body to come
SIGNED_OUT = 4401  # code of a close
GUARDED = ("/api/", "/metrics", "/openapi.json", "/docs", "/redoc", "/static-offline-docs")
TOO_LARGE = "The request's body is larger than server.most_body_bytes allows."


class Gate:
    """ASGI middleware. All of `GUARDED` is closed to strangers, except what is `open_paths`; the rest is the dashboard,
    which has to be there for somebody to sign in."""

    def __init__(self, app: ASGIApp, guard: Guard, open_paths: Collection[str], most_body_bytes: int) -> None:
        self._app, self._guard = app, guard
        self._open, self._most_bytes = frozenset(open_paths), most_body_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        try:
            path = scope["path"]
            who = self._guard.admit(HTTPConnection(scope), path in self._open or not path.startswith(GUARDED))
            scope.setdefault("state", {})["who"] = who
            if scope["type"] == "http":
                if not STOP.fullmatch(path):  # which is obeyed before its body is read
                    self._check_length(Headers(scope=scope))
                await self._app(scope, self._bounded(receive), send)
                return
        except ProblemError as error:
            await _refuse(error, scope, receive, send)
            return
        await self._attend(who, scope, receive, send)

    def _check_length(self, headers: Headers) -> None:
        """
        Raises:
            ProblemError: the header tells a body of more than is allowed.
        """
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > self._most_bytes:
            raise ProblemError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, TOO_LARGE)

    def _bounded(self, receive: Receive) -> Receive:
        """`receive` for a body of no more than is allowed, whatever its header says."""
        received, whole = 0, False

        async def bounded() -> Message:
            nonlocal received, whole
            if whole:
                return await receive()
            try:
                message = await asyncio.wait_for(receive(), BODY_S)
            except TimeoutError:
                raise HTTPException(HTTPStatus.REQUEST_TIMEOUT, "The request's body did not come. Ask again.") from None
            whole = not message.get("more_body", False)
            received += len(message.get("body", b""))
            if received > self._most_bytes:
                raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, TOO_LARGE)
            return message

        return bounded

    async def _attend(self, who: Who | None, scope: Scope, receive: Receive, send: Send) -> None:
        """A WebSocket, closed as soon as whoever opened it may not be here any more."""
        task = asyncio.current_task()
        if who is None or task is None:
            await self._app(scope, receive, send)  # an open one; its route says so
            return
        with self._guard.attending(who, task) as attendance:
            try:
                await self._app(scope, receive, send)
            except asyncio.CancelledError:
                if not attendance.ended:
                    raise
                task.uncancel()
                with contextlib.suppress(RuntimeError, OSError):  # it is closed already
                    await send({"type": "websocket.close", "code": SIGNED_OUT, "reason": "signed out"})


async def _refuse(error: ProblemError, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "http":
        await error.response()(scope, receive, send)
    else:
        await WebSocket(scope, receive, send).send_denial_response(error.response())
