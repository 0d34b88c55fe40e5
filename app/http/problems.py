"""Errors of the REST interface as `application/problem+json` (RFC 9457)."""

from collections.abc import Mapping
from http import HTTPStatus

from fastapi import FastAPI, Request, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from app.messages.system import Problem
from config.errors import GraspwatchError, RefusedError, ServiceError

PROBLEM_RESPONSE = {"content": {"application/problem+json": {"schema": Problem.model_json_schema()}}}


class ProblemError(Exception):
    """An error response to a request; `field` names the wrong part of the body."""

    def __init__(
        self, status: HTTPStatus, detail: str, field: str | None = None, headers: dict[str, str] | None = None
    ) -> None:
        super().__init__(detail)
        self.status, self.detail, self.field, self.headers = status, detail, field, headers

    def response(self) -> JSONResponse:
        errors = [{"field": self.field, "message": self.detail}] if self.field else None
        return _problem_response(self.status, self.detail, errors, self.headers)


def _problem_response(
    status: int, detail: str, errors: list[dict[str, str]] | None = None, headers: Mapping[str, str] | None = None
) -> JSONResponse:
    problem = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail, errors=errors)
    return JSONResponse(problem.model_dump(exclude_none=True), status, headers, media_type="application/problem+json")


def add_error_handlers(app: FastAPI) -> None:
    """Make `app` answer every error with problem details."""

    @app.exception_handler(ProblemError)
    async def on_problem(request: Request | WebSocket, error: ProblemError) -> JSONResponse | None:
        if isinstance(request, WebSocket):  # not accepted yet
            await request.send_denial_response(error.response())
            return None
        return error.response()

    @app.exception_handler(RequestValidationError)
    async def on_invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        errors = [
            {"field": ".".join(str(part) for part in fault["loc"][1:]) or "body", "message": fault["msg"]}
            for fault in error.errors()
        ]
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
        return _problem_response(error.status_code, str(error.detail), headers=error.headers)
