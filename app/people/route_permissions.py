"""Functions that collect the roles that all routes declare, for authentication and the API's description."""

from collections.abc import Iterable, Mapping

from fastapi import APIRouter
from fastapi.routing import APIRoute, APIWebSocketRoute

from app.messages.people import Role
from app.people.authorization import RoleRequirement

RoutePermissions = Mapping[tuple[str, str], Role | None]


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
