"""The gate before an application, without a network: what comes too slowly, and a route that forgot the gate."""

import asyncio
from typing import Any

import pytest
from fastapi import FastAPI

from app.http import problems
from app.messages.people import Role, SignIn
from app.people import auth_middleware, tokens
from app.people.authenticator import Authenticator
from app.people.authorization import require_role
from config.service_plan import ServicePlan


def answer(app: Any, path: str, receive: Any) -> int:
    """The status with which a POST is answered."""
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": "http",
        "method": "POST",
        "path": path,
        "raw_path": path.encode(),
        "query_string": b"",
        "scheme": "http",
        "http_version": "1.1",
        "server": ("127.0.0.1", 8000),
        "client": ("127.0.0.1", 5000),
        "headers": [(b"host", b"localhost:8000"), (b"content-type", b"application/json"), (b"content-length", b"9")],
    }
    asyncio.run(asyncio.wait_for(app(scope, receive, send), 5.0))
    return sent[0]["status"]


@pytest.fixture
def app(plan: ServicePlan) -> FastAPI:
    app = FastAPI()
    problems.add_error_handlers(app, app.routes)
    app.add_middleware(
        auth_middleware.AuthMiddleware,
        authenticator=Authenticator(plan),
        public_paths=["/api/open"],
        max_body_bytes=1000,
        max_upload_bytes={"/api/upload": 2000},
    )

    @app.post("/api/open")
    async def is_open(wanted: SignIn) -> str:
        return wanted.token

    return app


def test_a_body_that_does_not_come_is_not_waited_for(app: FastAPI, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(auth_middleware, "BODY_TIMEOUT_S", 0.05)

    async def silence() -> Any:
        await asyncio.sleep(60.0)

    assert answer(app, "/api/open", silence) == 408


def test_a_route_at_an_open_address_still_needs_what_it_says(app: FastAPI, plan: ServicePlan) -> None:
    tokens.add_token(plan.data_folder, "Ada", Role.ADMIN)
    app.router.routes.clear()
    app.post("/api/open", dependencies=[require_role(Role.VIEWER)])(lambda: None)

    async def nothing() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    assert answer(app, "/api/open", nothing) == 401
