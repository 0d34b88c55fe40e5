"""The roles that all routes declare, for the authentication and for the API's description."""

from collections.abc import Iterable, Mapping
from http import HTTPStatus
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute, APIWebSocketRoute

from app.http.problems import PROBLEM_RESPONSE
from app.messages.people import Role
from app.people.authorization import RoleRequirement

RoutePermissions = Mapping[tuple[str, str], Role | None]
REFUSAL_STATUSES = (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.TOO_MANY_REQUESTS)


def collect_route_permissions(routers: Iterable[APIRouter]) -> RoutePermissions:
    """Return the role that each route needs, by method (or `WEBSOCKET`) and path; None: the route is public.

    Raises:
        RuntimeError: a route declares no role.
    """
    declared = {}
    for route in (route for router in routers for route in router.routes):
        assert isinstance(route, APIRoute | APIWebSocketRoute)
        said = [each.dependency.role for each in route.dependencies if isinstance(each.dependency, RoleRequirement)]
        if len(said) != 1:
            raise RuntimeError(f"{route.path} does not say who may: add `dependencies=[require_role(Role....)]` to it.")
        for method in getattr(route, "methods", {"WEBSOCKET"}):
            declared[method, route.path] = said[0]
    return declared


def find_public_paths(permissions: RoutePermissions) -> set[str]:
    return {path for (_, path), role in permissions.items() if role is None}


def add_roles_to_openapi(app: FastAPI, permissions: RoutePermissions) -> None:
    """Add the role and the refusals of each operation to the API's description."""
    plain = app.openapi

    def described() -> dict[str, Any]:
        if app.openapi_schema is None:
            schema = plain()
            schema["components"]["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
            for (method, path), role in permissions.items():
                operation = schema["paths"].get(path, {}).get(method.lower())
                if operation and role:
                    operation |= {"security": [{"token": []}], "x-role": role.value}
                    for status in REFUSAL_STATUSES:
                        operation["responses"].setdefault(
                            str(status.value), {"description": status.phrase, **PROBLEM_RESPONSE}
                        )
        return app.openapi_schema or {}

    app.openapi = described
