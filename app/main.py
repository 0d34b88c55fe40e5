"""The web server: REST, WebSocket, metrics, documentation and the dashboard's files."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request, Response
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from fastapi_offline import FastAPIOffline
from starlette.middleware.base import RequestResponseEndpoint

from app import __version__, problems
from app.audit.deeds import Deeds
from app.audit.watch import ChainWatch
from app.demo import demonstrate
from app.plan import ServicePlan
from app.replay.films import Films
from app.replay.shelf import Shelf
from app.report.reports import Reports
from app.roles import Admin, is_loopback
from app.routes import alarms, audit, catalogue, history, live, recordings, runs, studies, system
from app.station import Station
from app.store.opening import open_for_service
from app.study.desk import StudyDesk
from config.errors import ServiceError

STATIC = Path(__file__).parent / "static"
DEAD_READER_MS = 10_000
PAGES = ("/", "/recordings", "/recordings/{name}", "/tissues", "/studies", "/system")
DOCUMENTATION = ("/docs", "/redoc", "/static-offline-docs")


def create_app(plan: ServicePlan) -> FastAPI:
    """The application for a plan; its workers live as long as it does.

    Raises:
        GraspwatchError: the index cannot be opened, or the admin's token not be read.
    """
    admin = Admin(plan.settings.server.admin_token_file)
    store = open_for_service(plan.index_url, plan.data)

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        station = app.state.station = Station(plan, store)
        desk = StudyDesk(plan.studies_folder, lambda text, by: station.tell_event(text, by=by))
        index = contextlib.aclosing(station.index)  # closed last: whatever ends has something to tell
        films, shelf = contextlib.aclosing(Films(plan)), contextlib.aclosing(Shelf(plan))
        reports = contextlib.aclosing(Reports(plan))
        await station.start()
        chain = contextlib.aclosing(ChainWatch(plan.data, station.index, station.alarms))
        demo = asyncio.create_task(demonstrate(station)) if plan.demo else None
        async with (
            index, desk as app.state.studies, films as app.state.films, shelf as app.state.shelf,
            reports as app.state.reports, chain as app.state.chain,
        ):  # fmt: skip
            try:
                yield
            finally:
                if demo:
                    demo.cancel()
                await station.stop()

    app = FastAPIOffline(
        title="Graspwatch",
        version=__version__,
        description="Watches a laparoscopic grasper close on tissue. Research instrument, not a medical device.",
        lifespan=lifespan,
    )
    app.state.admin = admin
    problems.install(app)
    for routes in (runs, history, audit, alarms, catalogue, system, studies, recordings, live):
        app.include_router(routes.router)
    app.middleware("http")(_add_security_headers)
    app.add_middleware(Deeds)
    if (STATIC / "index.html").is_file():
        for page in PAGES:
            app.get(page, include_in_schema=False)(_dashboard)
        app.mount("/", StaticFiles(directory=STATIC), name="dashboard")
    else:
        app.get("/", include_in_schema=False)(_dashboard_missing)
    return app


async def _dashboard() -> FileResponse:
    """Every page is the same document; it shows what its address says."""
    return FileResponse(STATIC / "index.html", headers={"Cache-Control": "no-cache"})


async def _dashboard_missing() -> Response:
    return Response("The dashboard has not been built. Run `make dashboard`, then start again.", 503)


async def _add_security_headers(request: Request, call_next: RequestResponseEndpoint) -> Response:
    response = await call_next(request)
    documentation = request.url.path.startswith(DOCUMENTATION)  # its pages carry a script of their own
    policy = "default-src 'self' 'unsafe-inline'; img-src 'self' data:" if documentation else "default-src 'self'"
    response.headers.setdefault("Content-Security-Policy", policy)  # a route may have set a narrower one
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["Referrer-Policy"] = "no-referrer"
    return response


def listen(host: str, port: int) -> socket.socket:
    """A listening socket that gives up on readers that never read.

    Raises:
        ServiceError: the port is taken or the address is not this machine's.
    """
    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, DEAD_READER_MS)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        raise ServiceError(
            f"Cannot listen on {host}, port {port}: {error.strerror}. Choose another with --port, or end the program "
            "that uses it."
        ) from None
    listener.listen(128)
    return listener


def serve(app: FastAPI, listener: socket.socket) -> None:
    """Serve until SIGINT or SIGTERM."""
    app.state.admin.only_this_machine = is_loopback(listener.getsockname()[0])
    config = uvicorn.Config(
        app,
        ws="websockets-sansio",
        ws_per_message_deflate=False,
        log_level="warning",
        access_log=False,
        timeout_graceful_shutdown=2,
    )
    uvicorn.Server(config).run(sockets=[listener])
