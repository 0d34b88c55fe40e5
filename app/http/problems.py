"""The error ProblemError, and handlers that answer errors as `application/problem+json` (RFC 9457)."""

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.routing import BaseRoute

from app.http.methods import list_allowed_methods
from app.messages.runs import Run
from app.messages.system import Problem
from config.errors import GraspwatchError, RefusedError, ServiceError

PROBLEM_MEDIA_TYPE = "application/problem+json"
PROBLEM_RESPONSE = {"content": {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}}
INVALID_RESPONSE: dict[int | str, dict[str, Any]] = {422: {"description": "A field is at fault", **PROBLEM_RESPONSE}}
UNREADABLE_BODY_TEXT = "The body cannot be read: it is not in UTF-8, or nested too deeply. Send JSON in UTF-8."
JSON_FAULTS = {
    "Expecting value": "a value is missing here, or it is no JSON value",
    "Expecting property name enclosed in double quotes": "a name in double quotes is expected here",
    "Expecting ',' delimiter": "a comma or a closing bracket is missing before this place",
    "Expecting ':' delimiter": "a colon is missing before this place",
    "Extra data": "the JSON has ended before this place, and more follows",
    "Unterminated string starting at": "the text that begins here has no closing quotation mark",
    "Invalid control character at": "a text may not contain a line break or another control character",
    "Illegal trailing comma before end of object": "the comma before the closing bracket is too much",
    "Illegal trailing comma before end of array": "the comma before the closing bracket is too much",
}
"""What is wrong with a body, by the words of Python's `json`; versions from 3.13 on know the trailing commas."""


class ProblemError(Exception):
    """An error response to a request; `field` names the wrong part of the body, `run` the run that is in the way."""

    def __init__(
        self,
        status: HTTPStatus,
        detail: str,
        field: str | None = None,
        headers: dict[str, str] | None = None,
        run: Run | None = None,
        messages: Sequence[str] = (),
    ) -> None:
        """`messages`: one for each fault of the field, where it has several; otherwise `detail` is its only one."""
        super().__init__(detail)
        self.status, self.detail, self.field, self.headers, self.run = status, detail, field, headers, run
        self._messages = messages or (detail,)

    def response(self) -> JSONResponse:
        errors = [{"field": self.field, "message": each} for each in self._messages] if self.field else None
        return _problem_response(self.status, self.detail, errors, self.headers, self.run)


def _problem_response(
    status: int,
    detail: str,
    errors: list[dict[str, str]] | None = None,
    headers: Mapping[str, str] | None = None,
    run: Run | None = None,
) -> JSONResponse:
    problem = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail, errors=errors, run=run)
    absent = {name for name in ("errors", "run") if getattr(problem, name) is None}
    return JSONResponse(problem.model_dump(mode="json", exclude=absent), status, headers, media_type=PROBLEM_MEDIA_TYPE)


def _describe_fault(fault: Mapping[str, Any], body: object) -> dict[str, str]:
    """Return field and message of one of FastAPI's validation errors; broken JSON is named by line and column."""
    if fault["type"] == "json_invalid" and isinstance(body, str):
        before = body[: fault["loc"][-1]]
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        said = fault["ctx"]["error"]
        message = f"No valid JSON at line {line}, column {column}: {JSON_FAULTS.get(said, said)}."
        return {"field": "body", "message": message}
    return {"field": ".".join(str(part) for part in fault["loc"][1:]) or "body", "message": fault["msg"]}


def add_error_handlers(app: FastAPI, routes: Sequence[BaseRoute] = ()) -> None:
    """Make `app` answer every error with problem details; `routes` are those of its routers."""

    @app.exception_handler(ProblemError)
    async def on_problem(request: Request | WebSocket, error: ProblemError) -> JSONResponse | None:
        if isinstance(request, WebSocket):  # not accepted yet
            await request.send_denial_response(error.response())
            return None
        return error.response()

    @app.exception_handler(RequestValidationError)
    async def on_invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        errors = [_describe_fault(fault, error.body) for fault in error.errors()]
        detail = "; ".join(f"{fault['field']}: {fault['message']}" for fault in errors)
        return _problem_response(HTTPStatus.UNPROCESSABLE_ENTITY, detail, errors)

    @app.exception_handler(ServiceError)
    async def on_service_error(request: Request, error: ServiceError) -> JSONResponse:
        return _problem_response(HTTPStatus.SERVICE_UNAVAILABLE, str(error))

    @app.exception_handler(RefusedError)
    async def on_refused(request: Request, error: RefusedError) -> JSONResponse:
        return _problem_response(HTTPStatus.CONFLICT, str(error))

    @app.exception_handler(GraspwatchError)
    async def on_graspwatch_error(request: Request, error: GraspwatchError) -> JSONResponse:
        return _problem_response(HTTPStatus.INTERNAL_SERVER_ERROR, str(error))

    @app.exception_handler(HTTPException)
    async def on_http(request: Request, error: HTTPException) -> JSONResponse:
        if error.status_code in (HTTPStatus.NOT_FOUND, HTTPStatus.METHOD_NOT_ALLOWED):
            allowed = list_allowed_methods([*routes, *app.routes], request.scope)
            if allowed and request.method not in allowed:
                return _refuse_method(request, allowed)
            if request.scope["path"].startswith("/api/"):  # the dashboard's files, which come last, answered
                return _problem_response(HTTPStatus.NOT_FOUND, "There is nothing at this address.")
        detail = UNREADABLE_BODY_TEXT if error.status_code == HTTPStatus.BAD_REQUEST else str(error.detail)
        return _problem_response(error.status_code, detail, headers=error.headers)


def _refuse_method(request: Request, allowed: list[str]) -> JSONResponse:
    """Name every method of a path."""
    methods = ", ".join(allowed)
    detail = f"This address does not answer {request.method}. It answers {methods}."
    return _problem_response(HTTPStatus.METHOD_NOT_ALLOWED, detail, headers={"Allow": methods})
