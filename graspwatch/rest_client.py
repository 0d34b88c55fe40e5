"""The class RestClient, which sends REST requests with httpx, and functions that build the client's errors."""

from collections.abc import AsyncGenerator
from http import HTTPStatus
from typing import Any, TypeVar

import httpx
from pydantic import BaseModel, TypeAdapter, ValidationError

from app.messages.system import Problem
from graspwatch.errors import RefusedError, UnreachableError

Answer = TypeVar("Answer")


def build_refused_error(status: int, content: bytes | bytearray) -> RefusedError:
    """Return the `RefusedError` for an error response, with the service's own message."""
    try:
        problem = Problem.model_validate_json(content)
    except ValidationError:
        return RefusedError(status, HTTPStatus(status).phrase, {})
    return RefusedError(status, problem.detail, {each["field"]: each["message"] for each in problem.errors or []})


def build_unreachable_error(url: httpx.URL, error: Exception) -> UnreachableError:
    why = str(error) or type(error).__name__
    return UnreachableError(f"Nobody answers at {str(url).rstrip('/')} ({why}): is it running there?")


class RestClient:
    """REST client. Every method may raise `UnreachableError` and `RefusedError`."""

    def __init__(self, http: httpx.AsyncClient) -> None:
        self._http = http

    async def ask(
        self,
        answer: type[Answer],
        method: str,
        path: str,
        body: BaseModel | None = None,
        *,
        params: dict[str, Any] | None = None,
        headers: dict[str, str] | None = None,
        fine: tuple[int, ...] = (),
    ) -> Answer:
        """Return the response as the type `answer`; an error status in `fine` does not raise."""
        content = body.model_dump(mode="json", exclude_none=True) if body else None
        response = await self.request(method, path, fine=fine, json=content, params=params, headers=headers)
        return TypeAdapter(answer).validate_json(response.content)

    async def request(self, method: str, path: str, *, fine: tuple[int, ...] = (), **request: Any) -> httpx.Response:
        try:
            response = await self._http.request(method, path, **request)
        except httpx.TransportError as error:
            raise build_unreachable_error(self._http.base_url, error) from error
        if response.is_error and response.status_code not in fine:
            raise build_refused_error(response.status_code, response.content)
        return response

    async def parts(self, path: str) -> AsyncGenerator[bytes, None]:
        """Yield a long response in parts."""
        try:
            async with self._http.stream("GET", path) as response:
                if response.is_error:
                    raise build_refused_error(response.status_code, await response.aread())
                async for part in response.aiter_bytes():
                    yield part
        except httpx.TransportError as error:
            raise build_unreachable_error(self._http.base_url, error) from error
