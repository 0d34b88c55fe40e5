"""Who asked for what, from where, and what came of it: a line of the journal for each request for a change.

It is noted here for all routes at once, so that none can be forgotten. A route may say better what is asked for, and
who asks, with `note_deed`; a reading request that changes something all the same notes itself with `Journal.deed`.
"""

import json
from http import HTTPStatus
from typing import Any

from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.audit.journal import Journal
from app.http.methods import SAFE_METHODS
from app.http.request_origin import forwarded_headers
from app.messages.wire import Result

MAX_BODY_BYTES = 20_000  # enough for whose name is in a request, and for why it was refused
MAX_NAME_LENGTH, MAX_REASON_LENGTH, MAX_CLIENT_LENGTH = 40, 500, 200  # what is said may be of any length


def note_request(request: HTTPConnection, *, description: str | None = None, by: str | None = None) -> None:
    """Say in a request's line of the journal what it asks for (`Start run sine`), and who asks where that is known for
    sure: else it is whom the request names."""
    said = {"what": description, "by": by}
    request.state.deed = getattr(request.state, "deed", {}) | {name: each for name, each in said.items() if each}


def describe_client(request: HTTPConnection) -> str:
    """From where a request comes; what a proxy says of that may be wrong, and is marked as said."""
    host = request.client.host if request.client else "unknown"
    said = [f"{name}: {value}" for name, value in forwarded_headers(request)]
    return (f"{host} ({'; '.join(said)})" if said else host)[:MAX_CLIENT_LENGTH]


class AuditMiddleware:
    """Middleware: notes what came of each request once it has been answered."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

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
            _write_journal_entry(HTTPConnection(scope), bytes(asked), status, bytes(answered))


def _write_journal_entry(
    request: HTTPConnection, request_body: bytes, status: HTTPStatus, response_body: bytes
) -> None:
    route = request.scope.get("route")
    if route is None and status is not HTTPStatus.FORBIDDEN:
        return  # nothing is there that could have been changed, or the gate knows nobody, and says so itself
    journal: Journal = request.app.state.station.journal
    deed = getattr(request.state, "deed", {})
    name = route.name if route else str(request.scope["method"])
    words = [name.replace("_", " ").capitalize(), *map(str, request.path_params.values())]
    if route is None:
        words = [name, str(request.scope["path"])[:MAX_REASON_LENGTH]]
    result, reason = Result.DONE, None
    if status >= HTTPStatus.BAD_REQUEST:
        result = Result.FAILED if status >= HTTPStatus.INTERNAL_SERVER_ERROR else Result.REFUSED
        reason = str(_json_field(response_body, "detail") or status.phrase)[:MAX_REASON_LENGTH]
    journal.write_request(
        name,
        deed.get("what") or " ".join(words),
        client=describe_client(request),
        result=result,
        by=deed.get("by") or _signed_in_name(request) or _claimed_name(request, request_body),
        reason=reason,
    )


def _signed_in_name(request: HTTPConnection) -> str | None:
    """Whom the gate knows; what else a request says of that does not count then."""
    who = getattr(request.state, "who", None)
    return who.name if who else None


def _claimed_name(request: HTTPConnection, request_body: bytes) -> str | None:
    """Whom a request names, in its query or its body."""
    name = request.query_params.get("by") or _json_field(request_body, "by")
    return name[:MAX_NAME_LENGTH] if isinstance(name, str) and name.strip() else None


def _json_field(document: bytes, name: str) -> Any:
    try:
        content = json.loads(document)
    except (ValueError, RecursionError):
        return None
    return content.get(name) if isinstance(content, dict) else None
