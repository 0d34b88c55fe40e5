"""Functions that create and serve the web application: REST, WebSocket, metrics, documentation, dashboard."""

import asyncio
import contextlib
import logging
import multiprocessing
import signal
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import uvicorn
from fastapi import Depends, FastAPI, Request, Response
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from fastapi_offline import FastAPIOffline
from starlette.middleware.base import RequestResponseEndpoint

from app import __version__
from app.analysis.calibration_session import CalibrationSession
from app.analysis.report.report_cache import ReportCache
from app.analysis.study_runner import StudyRunner
from app.api.dependencies import Services, renew_control
from app.api.openapi import TAGS, describe_api, make_operation_id
from app.api.recording_bin import RecordingBin
from app.api.routes import (
    alarms,
    all_recordings,
    annotations,
    audit,
    bin,
    calibration,
    configuration,
    control_lease,
    history,
    lab_sessions,
    live,
    recordings,
    runs,
    session,
    studies,
    system,
    tool,
)
from app.host.logs import LogContext, configure_logging
from app.http import problems
from app.http.audit_middleware import AuditMiddleware
from app.http.connection_limiter import (
    LingeringWebSocketProtocol,
    TlsTimeoutEventLoop,
    make_connection_limiter,
    reserve_open_files,
)
from app.http.idempotency import IdempotentAnswers
from app.http.methods import build_head_router
from app.index.database import index_url_from_settings
from app.index.opening import open_store_for_service
from app.people.auth_middleware import AuthMiddleware
from app.people.authenticator import Authenticator
from app.people.authorization import PUBLIC_ROUTE
from app.people.route_permissions import collect_route_permissions, find_public_paths
from app.recordings.catalog import RecordingCatalog
from app.recordings.index_reader import RECORDING_READERS
from app.recordings.replay.cache_store import ReplayCacheStore
from app.service.configuration_files import ConfigurationFiles
from app.service.demonstration import play_demonstration
from app.service.journal_watch import JournalWatch
from app.service.tool_service import ToolService
from config.errors import ServiceError
from config.service_plan import ServicePlan

STATIC_FOLDER = Path(__file__).parents[1] / "static"
TCP_USER_TIMEOUT_MS = 10_000
DASHBOARD_PATHS = (
    "/",
    "/recordings",
    "/recordings/{name}",
    "/tissues",
    "/studies",
    "/system",
    "/calibration",
    "/configuration",
)
DOCUMENTATION_PATHS = ("/docs", "/redoc", "/static-offline-docs")
CONTENT_SECURITY_POLICY = (
    "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
DOCUMENTATION_SECURITY_POLICY = "default-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'"
SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
ROUTE_MODULES = (
    runs,
    annotations,
    lab_sessions,
    control_lease,
    calibration,
    session,
    history,
    all_recordings,
    audit,
    alarms,
    tool,
    configuration,
    system,
    studies,
    recordings,
    bin,
    live,
)
ROUTERS = tuple(each.router for each in ROUTE_MODULES)
MAX_WEBSOCKET_MESSAGE_BYTES = 65_536  # one message from a viewer
SHUTDOWN_GRACE_S = 0.3
"""Time at shutdown for responses under way; a longer download is cut off."""


def create_app(plan: ServicePlan) -> FastAPI:
    """Create the application for a plan; its lifespan starts and stops the workers.

    Raises:
        GraspwatchError: the index cannot be opened, or the file of people cannot be read.
    """
    authenticator, log_context = Authenticator(plan), LogContext()
    store = open_store_for_service(
        index_url_from_settings(plan.settings, plan.data_folder), plan.data_folder, RECORDING_READERS
    )

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        try:
            tool_service = ToolService(plan, store, log_context)
            await tool_service.start()
        except Exception as error:
            app.state.start_error = error  # for `serve`: uvicorn would only log it
            raise
        studies = StudyRunner(plan.studies_folder, lambda text, by: tool_service.publisher.publish_event(text, by=by))
        replay_caches, reports, catalog = ReplayCacheStore(plan), ReportCache(plan), RecordingCatalog(plan)
        calibration_session = CalibrationSession(plan, tool_service)
        index = contextlib.aclosing(tool_service.index_writer)  # closed last: the other parts write to it as they end
        recording_bin = RecordingBin(plan, tool_service, replay_caches, reports)
        journal_watch = JournalWatch(plan.data_folder, tool_service.index_writer, tool_service.alarms)
        app.state.services = Services(
            authenticator,
            tool_service,
            calibration_session,
            studies,
            replay_caches,
            catalog,
            reports,
            journal_watch,
            recording_bin,
            IdempotentAnswers(),
            ConfigurationFiles(plan, tool_service.runs, lambda: calibration_session.tool_source),
        )
        watch = asyncio.create_task(authenticator.watch_token_file(tool_service))
        tool_service.tasks.watch(watch)
        demo = asyncio.create_task(play_demonstration(tool_service)) if plan.demo_enabled else None
        async with (
            index,
            studies,
            contextlib.aclosing(replay_caches),
            contextlib.aclosing(catalog),
            contextlib.aclosing(reports),
            contextlib.aclosing(journal_watch),
            contextlib.aclosing(recording_bin),
        ):
            try:
                yield
            finally:
                watch.cancel()
                if demo:
                    demo.cancel()
                await tool_service.stop()

    app = FastAPIOffline(
        title="Graspwatch",
        version=__version__,
        description="Watches a laparoscopic grasper close on tissue. Research instrument, not a medical device.",
        openapi_tags=TAGS,
        generate_unique_id_function=make_operation_id,
        lifespan=lifespan,
    )
    app.state.log_context, app.state.start_error = log_context, None
    rights = collect_route_permissions(ROUTERS)
    describe_api(app, rights)
    problems.add_error_handlers(app, [route for router in ROUTERS for route in router.routes])
    for router in ROUTERS:
        app.include_router(router, dependencies=[Depends(renew_control)])
        app.include_router(build_head_router(router))
    app.add_middleware(
        AuthMiddleware,
        authenticator=authenticator,
        public_paths=find_public_paths(rights),
        max_body_bytes=plan.settings.server.most_body_bytes,
        max_upload_bytes={configuration.DRAFT_PATH: configuration.MAX_RECORDING_BYTES},
    )
    app.middleware("http")(_add_security_headers)
    app.add_middleware(AuditMiddleware, get_journal=lambda: app.state.services.tool.journal)
    has_dashboard = (STATIC_FOLDER / "index.html").is_file()
    if has_dashboard:
        for page in DASHBOARD_PATHS:
            app.get(page, dependencies=[PUBLIC_ROUTE], include_in_schema=False)(serve_dashboard_page)
    else:
        app.get("/", dependencies=[PUBLIC_ROUTE], include_in_schema=False)(serve_dashboard_missing)
    app.include_router(build_head_router(app.router))  # of the pages and the documentation
    if has_dashboard:
        app.mount("/", StaticFiles(directory=STATIC_FOLDER), name="dashboard")
    return app


async def serve_dashboard_page() -> FileResponse:
    """Return the dashboard's only HTML document; its script shows the page that the URL names."""
    return FileResponse(STATIC_FOLDER / "index.html", headers={"Cache-Control": "no-cache"})


async def serve_dashboard_missing() -> Response:
    return Response("The dashboard has not been built. Run `make dashboard`, then start again.", 503)


async def _add_security_headers(request: Request, call_next: RequestResponseEndpoint) -> Response:
    response = await call_next(request)
    documentation = request.scope["path"].startswith(DOCUMENTATION_PATHS)  # these pages contain an inline script
    policy = DOCUMENTATION_SECURITY_POLICY if documentation else CONTENT_SECURITY_POLICY
    response.headers.setdefault("Content-Security-Policy", policy)  # a route may have set a narrower one
    if request.scope["path"].startswith("/api/"):
        response.headers.setdefault("Cache-Control", "no-store")
    response.headers.update(SECURITY_HEADERS)
    return response


def open_listener(host: str, port: int) -> socket.socket:
    """Open a listening socket that drops clients which never read. An IPv6 address may be in brackets.

    Raises:
        ServiceError: the port is taken, or the address is not this machine's.
    """
    host = host.removeprefix("[").removesuffix("]")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # asyncio disables Nagle's algorithm only on a socket whose protocol is explicitly TCP.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, TCP_USER_TIMEOUT_MS)
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


def serve(app: FastAPI, listener: socket.socket, plan: ServicePlan, on_started: Callable[[], None]) -> None:
    """Serve until SIGINT, SIGTERM or SIGHUP; call `on_started` once the workers are started.

    Raises:
        Exception: the tool's service or its workers could not be started.
    """
    server = plan.settings.server
    configure_logging(plan.settings.logs, plan.data_folder, app.state.log_context)
    config = uvicorn.Config(
        app,
        http=make_connection_limiter(reserve_open_files(server.most_connections)),
        ws=LingeringWebSocketProtocol,
        ws_per_message_deflate=False,
        ws_max_size=MAX_WEBSOCKET_MESSAGE_BYTES,
        ssl_certfile=server.tls_cert,
        ssl_keyfile=server.tls_key,
        server_header=False,
        log_config=None,  # uvicorn logs through the service's handlers
        log_level="warning",
        access_log=False,
        proxy_headers=False,  # rights go by the connection's own address, not by what a proxy claims
        # uvicorn only passes it to `asyncio.wait_for`, which takes fractions
        timeout_graceful_shutdown=SHUTDOWN_GRACE_S,  # pyright: ignore[reportArgumentType]
    )
    logging.getLogger("uvicorn.error").addFilter(
        lambda record: app.state.start_error is None and _is_no_refused_handshake(record)
    )
    with asyncio.Runner(loop_factory=TlsTimeoutEventLoop) as runner:
        runner.run(_Server(config, app, on_started).serve(sockets=[listener]))
    if app.state.start_error:
        for worker in multiprocessing.active_children():
            worker.terminate()
        raise app.state.start_error


class _Server(uvicorn.Server):
    """A uvicorn server that halts the tool before it waits for connections to end."""

    def __init__(self, config: uvicorn.Config, app: FastAPI, on_started: Callable[[], None]) -> None:
        super().__init__(config)
        self._app, self._on_started = app, on_started

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self._app.state.start_error is None:
            self._on_started()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Handle SIGHUP, the end of the terminal, as uvicorn handles SIGTERM; it raises both again afterwards."""
        with super().capture_signals():
            before = signal.getsignal(signal.SIGHUP)
            if before is not signal.SIG_IGN:
                signal.signal(signal.SIGHUP, self.handle_exit)
            try:
                yield
            finally:
                signal.signal(signal.SIGHUP, before)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await self._app.state.services.tool.run_controller.halt()
        await super().shutdown(sockets)


def _is_no_refused_handshake(record: logging.LogRecord) -> bool:
    """Return False for uvicorn's error about a refused WebSocket: a flood of refusals would fill the log."""
    return "without completing handshake" not in record.getMessage()
