"""The HTTP methods that change nothing, and functions for HEAD routes and the methods that a path allows."""

from collections.abc import Iterable

from fastapi import APIRouter
from fastapi.routing import APIRoute
from starlette.routing import BaseRoute, Match, Route
from starlette.types import Scope

SAFE_METHODS = ("GET", "HEAD", "OPTIONS")


def build_head_router(router: APIRouter) -> APIRouter:
    """Return a router that answers HEAD wherever `router` answers GET, with the same dependencies (RFC 9110).

    Uvicorn leaves out the body. A route that would compute or read much checks `request.method` itself.
    """
    heads = APIRouter(include_in_schema=False)
    for route in router.routes:
        if isinstance(route, APIRoute) and "GET" in (route.methods or ()):
            heads.add_api_route(
                route.path,
                route.endpoint,
                methods=["HEAD"],
                name=route.name,
                dependencies=route.dependencies,
                response_model=route.response_model,
                response_class=route.response_class,
            )
    return heads


def list_allowed_methods(routes: Iterable[BaseRoute], scope: Scope) -> list[str]:
    """Return the methods that `routes` answer for a request's path, sorted; empty if there is no such path."""
    allowed = {
        method
        for route in routes
        if isinstance(route, Route) and route.matches(scope)[0] is not Match.NONE
        for method in route.methods or ()
    }
    return sorted(allowed | ({"HEAD"} if "GET" in allowed else set()))
