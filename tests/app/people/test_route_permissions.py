"""Every route says which role it needs, and nothing is reachable beside the routes."""

import pytest
from fastapi import APIRouter
from fastapi.routing import APIRoute
from people import RIGHTS
from starlette.routing import Mount

from app.api import app as main
from app.people.auth_middleware import PROTECTED_PATHS
from app.people.route_permissions import collect_route_permissions
from config.service_plan import ServicePlan


def test_every_route_needs_what_was_agreed() -> None:
    assert collect_route_permissions(main.ROUTERS) == RIGHTS


def test_a_route_that_does_not_say_who_may_keeps_the_service_from_starting(
    plan: ServicePlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    router = APIRouter()
    router.get("/api/new")(lambda: None)
    monkeypatch.setattr(main, "ROUTERS", (*main.ROUTERS, router))
    with pytest.raises(RuntimeError, match="/api/new does not say who may"):
        main.create_app(plan)


def test_what_is_beside_the_routers_is_guarded_or_the_dashboard(plan: ServicePlan) -> None:
    app = main.create_app(plan)
    direct = [route for route in app.routes if hasattr(route, "path")]
    open_ones = {route.path for route in direct if not route.path.startswith(PROTECTED_PATHS)}
    assert open_ones <= {*main.DASHBOARD_PATHS, ""}  # "" is the folder of the dashboard's files
    assert {route.path for route in direct if isinstance(route, Mount)} <= {"", "/static-offline-docs"}
    pages = [route for route in direct if isinstance(route, APIRoute) and route.path in main.DASHBOARD_PATHS]
    assert pages
    assert all(route.methods == {"GET"} for route in pages)
