"""The web server: REST, WebSocket, metrics, documentation and the dashboard's files."""

import asyncio
import contextlib
import logging
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request, Response
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from fastapi_offline import FastAPIOffline
from starlette.middleware.base import RequestResponseEndpoint
from starlette.types import ASGIApp, Receive, Scope, Send

from app import __version__, problems
from app.audit.deeds import Deeds
from app.audit.watch import ChainWatch
from app.bench.desk import CalibrationDesk
from app.demo import demonstrate
from app.logs import About, log_aside
from app.people.door import Loop, WebSocketDoor, allow_many_files, bounded
from app.people.gate import Gate
from app.people.guard import Guard
from app.people.rights import describe, open_paths, rights_of
from app.people.roles import ANYBODY
from app.plan import ServicePlan
from app.recording_bin import RecordingBin
from app.replay.films import Films
from app.replay.shelf import Shelf
from app.report.reports import Reports
from app.routes import (
    alarms,
    audit,
    bin,
    calibration,
    catalogue,
    control,
    history,
    live,
    recordings,
    runs,
    session,
    studies,
    system,
)
from app.station import Station
from app.store.opening import open_for_service
from app.study.desk import StudyDesk
from config.errors import ServiceError

STATIC = Path(__file__).parent / "static"
DEAD_READER_MS = 10_000
PAGES = ("/", "/recordings", "/recordings/{name}", "/tissues", "/studies", "/system", "/calibration")
DOCUMENTATION = ("/docs", "/redoc", "/static-offline-docs")
POLICY = "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
DOCUMENTATION_POLICY = "default-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'"
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
ROUTES = (
    runs,
    control,
    calibration,
    session,
    history,
    audit,
    alarms,
    catalogue,
    system,
    studies,
    recordings,
    bin,
    live,
)
ROUTERS = tuple(each.router for each in ROUTES)
LONGEST_WORD_BYTES = 65_536  # of a viewer
GRACE_S = 0.3
"""At the end, for answers that are under way; a download that takes longer is cut."""


def create_app(plan: ServicePlan) -> FastAPI:
    """The application for a plan; its workers live as long as it does.

    Raises:
        GraspwatchError: the index cannot be opened, or the file of people not be read.
    """
    guard = Guard(plan)
    store = open_for_service(plan.index_url, plan.data)

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        station = app.state.station = Station(plan, store, app.state.about)
        app.state.calibration = CalibrationDesk(plan, station)
        desk = StudyDesk(plan.studies_folder, lambda text, by: station.tell_event(text, by=by))
        index = contextlib.aclosing(station.index)  # closed last: whatever ends has something to tell
        films, reports, shelf = Films(plan), Reports(plan), contextlib.aclosing(Shelf(plan))
        await station.start()
        recording_bin = contextlib.aclosing(RecordingBin(plan, station, films, reports))
        chain = contextlib.aclosing(ChainWatch(plan.data, station.index, station.alarms))
        watch = asyncio.create_task(guard.watch(station))
        station.watch_over(watch)
        demo = asyncio.create_task(demonstrate(station)) if plan.demo else None
        async with (
            index,
            desk as app.state.studies,
            contextlib.aclosing(films) as app.state.films,
            shelf as app.state.shelf,
            contextlib.aclosing(reports) as app.state.reports,
            chain as app.state.chain,
            recording_bin as app.state.bin,
        ):
            try:
                yield
            finally:
                watch.cancel()
                if demo:
                    demo.cancel()
                await station.stop()

    app = FastAPIOffline(
        title="Graspwatch",
        version=__version__,
        description="Watches a laparoscopic grasper close on tissue. Research instrument, not a medical device.",
        lifespan=lifespan,
    )
    app.state.guard, app.state.about = guard, About()
    rights = rights_of(ROUTERS)
    describe(app, rights)
    problems.install(app)
    for router in ROUTERS:
        app.include_router(router)
    app.add_middleware(
        Gate, guard=guard, open_paths=open_paths(rights), most_body_bytes=plan.settings.server.most_body_bytes
    )
    app.middleware("http")(_add_security_headers)
    app.add_middleware(Deeds)
    app.add_middleware(HeadAsGet)
    if (STATIC / "index.html").is_file():
        for page in PAGES:
            app.get(page, dependencies=[ANYBODY], include_in_schema=False)(_dashboard)
        app.mount("/", StaticFiles(directory=STATIC), name="dashboard")
    else:
        app.get("/", dependencies=[ANYBODY], include_in_schema=False)(_dashboard_missing)
    return app


async def _dashboard() -> FileResponse:
    """Every page is the same document; it shows what its address says."""
    return FileResponse(STATIC / "index.html", headers={"Cache-Control": "no-cache"})


async def _dashboard_missing() -> Response:
    return Response("The dashboard has not been built. Run `make dashboard`, then start again.", 503)


async def _add_security_headers(request: Request, call_next: RequestResponseEndpoint) -> Response:
    response = await call_next(request)
    documentation = request.scope["path"].startswith(DOCUMENTATION)  # its pages carry a script of their own
    policy = DOCUMENTATION_POLICY if documentation else POLICY
    response.headers.setdefault("Content-Security-Policy", policy)  # a route may have set a narrower one
    if request.scope["path"].startswith("/api/"):
        response.headers.setdefault("Cache-Control", "no-store")
    response.headers.update(HEADERS)
    return response


class HeadAsGet:
    """Middleware: HEAD is answered as GET is; the server that runs the application leaves out the body (RFC 9110)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope.get("method") == "HEAD":
            scope = {**scope, "method": "GET"}
        await self._app(scope, receive, send)


def listen(host: str, port: int) -> socket.socket:
    """A listening socket that gives up on readers that never read. An IPv6 address may stand in brackets.

    Raises:
        ServiceError: the port is taken or the address is not this machine's.
    """
    host = host.removeprefix("[").removesuffix("]")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(
        family, socket.SOCK_STREAM, socket.IPPROTO_TCP
    )  # unless TCP is named, asyncio lets Nagle wait
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


def serve(app: FastAPI, listener: socket.socket, plan: ServicePlan) -> None:
    """Serve until SIGINT or SIGTERM."""
    server = plan.settings.server
    log_aside(plan.settings.logs, plan.data, app.state.about)
    config = uvicorn.Config(
        app,
        http=bounded(server.most_connections),
        ws=WebSocketDoor,
        ws_per_message_deflate=False,
        ws_max_size=LONGEST_WORD_BYTES,
        ssl_certfile=server.tls_cert,
        ssl_keyfile=server.tls_key,
        server_header=False,
        log_config=None,  # its loggers' lines go where all others do
        log_level="warning",
        access_log=False,
        proxy_headers=False,  # who asks is whose address it is; what a proxy says of that is noted as said
        timeout_graceful_shutdown=GRACE_S,
    )
    logging.getLogger("uvicorn.error").addFilter(_is_news)
    allow_many_files()
    with asyncio.Runner(loop_factory=Loop) as runner:
        runner.run(_Server(config, app).serve(sockets=[listener]))


class _Server(uvicorn.Server):
    """Halts the tool before it waits for anybody's connection to end."""

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._app = app

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await self._app.state.station.halt()
        await super().shutdown(sockets)


def _is_news(record: logging.LogRecord) -> bool:
    """uvicorn takes a WebSocket that was refused with an answer for a failure, and would say so for each of a flood."""
    return "without completing handshake" not in record.getMessage()
