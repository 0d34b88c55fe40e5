"""Middleware that writes a journal line for each request for a change: requester, action, client and result.

It serves all routes, so that none can be forgotten. A route may describe action and requester better with
`note_request`. A GET request that changes something calls `Journal.write_request` itself.
"""

import json
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.audit.journal import Journal
from app.http.methods import SAFE_METHODS
from app.http.request_origin import forwarded_headers
from app.messages.journal import Result

MAX_BODY_BYTES = 20_000  # enough for the requester's name and for the reason of a refusal
MAX_NAME_LENGTH, MAX_REASON_LENGTH, MAX_CLIENT_LENGTH = 40, 500, 200  # clients may send texts of any length


def note_request(request: HTTPConnection, *, description: str | None = None, by: str | None = None) -> None:
    """Set the action (`Start run sine`) and the verified requester for a request's journal line.

    Without `by`, the line names the signed-in user, else the name in the request.
    """
    said = {"what": description, "by": by}
    request.state.request_note = getattr(request.state, "request_note", {}) | {
        name: each for name, each in said.items() if each
    }


def note_read_only(request: HTTPConnection) -> None:
    """Keep a request that changes nothing, such as a check of a text in its body, out of the journal."""
    request.state.is_read_only = True


def describe_client(request: HTTPConnection) -> str:
    """Return a request's address; the claims of a proxy may be wrong and follow in parentheses."""
    host = request.client.host if request.client else "unknown"
    said = [f"{name}: {value}" for name, value in forwarded_headers(request)]
    return (f"{host} ({'; '.join(said)})" if said else host)[:MAX_CLIENT_LENGTH]


class AuditMiddleware:
    """ASGI middleware that writes a request and its result to the journal once it is answered."""

    def __init__(self, app: ASGIApp, get_journal: Callable[[], Journal]) -> None:
        """Take the application, and a function that returns its journal while it serves requests."""
        self._app, self._get_journal = app, get_journal

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] in SAFE_METHODS:
            await self._app(scope, receive, send)
            return
        asked, answered = bytearray(), bytearray()
        status = HTTPStatus.INTERNAL_SERVER_ERROR

        async def receive_and_copy() -> Message:
            message = await receive()
            asked.extend(message.get("body", b"")[: MAX_BODY_BYTES - len(asked)])
            return message

        async def send_and_copy(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = HTTPStatus(message["status"])
            elif status >= HTTPStatus.BAD_REQUEST:
                answered.extend(message.get("body", b"")[: MAX_BODY_BYTES - len(answered)])
            await send(message)

        try:
            await self._app(scope, receive_and_copy, send_and_copy)
        finally:
            _write_journal_entry(self._get_journal, HTTPConnection(scope), bytes(asked), status, bytes(answered))


def _write_journal_entry(
    get_journal: Callable[[], Journal],
    request: HTTPConnection,
    request_body: bytes,
    status: HTTPStatus,
    response_body: bytes,
) -> None:
    route = request.scope.get("route")
    if getattr(request.state, "is_read_only", False):
        return
    if route is None and status is not HTTPStatus.FORBIDDEN:
        return  # no such route, or AuthMiddleware refused an unknown user; it logs wrong tokens itself
    note = getattr(request.state, "request_note", {})
    name = route.name if route else str(request.scope["method"])
    words = [name.replace("_", " ").capitalize(), *map(str, request.path_params.values())]
    if route is None:
        words = [name, str(request.scope["path"])[:MAX_REASON_LENGTH]]
    result, reason = Result.DONE, None
    if status >= HTTPStatus.BAD_REQUEST:
        result = Result.FAILED if status >= HTTPStatus.INTERNAL_SERVER_ERROR else Result.REFUSED
        reason = str(_json_field(response_body, "detail") or status.phrase)[:MAX_REASON_LENGTH]
    get_journal().write_request(
        name,
        note.get("what") or " ".join(words),
        client=describe_client(request),
        result=result,
        by=note.get("by") or _signed_in_name(request) or _claimed_name(request, request_body),
        reason=reason,
    )


def _signed_in_name(request: HTTPConnection) -> str | None:
    """Return the user that AuthMiddleware found, who takes precedence over any name in the request."""
    user = getattr(request.state, "user", None)
    return user.name if user else None


def _claimed_name(request: HTTPConnection, request_body: bytes) -> str | None:
    """Return the name that the request gives in its query or body."""
    name = request.query_params.get("by") or _json_field(request_body, "by")
    return name[:MAX_NAME_LENGTH] if isinstance(name, str) and name.strip() else None


def _json_field(document: bytes, name: str) -> Any:
    try:
        content = json.loads(document)
    except (ValueError, RecursionError):
        return None
    return content.get(name) if isinstance(content, dict) else None
