"""The start of the server, for `serve` and `replay --serve`."""

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from app import __version__
from app.cli.console import error_console
from app.host.system_errors import check_address_space
from config.network import reachable_host
from config.schema import Settings

if TYPE_CHECKING:
    from config.service_plan import ServicePlan


def apply_tls_options(settings: Settings, cert: Path | None, key: Path | None) -> Settings:
    """Return the settings with the certificate and key that the options name, if any."""
    changes = {name: str(path) for name, path in (("tls_cert", cert), ("tls_key", key)) if path}
    return settings.model_copy(update={"server": settings.server.model_copy(update=changes)})


def start_server(plan: "ServicePlan", host: str | None, port: int | None) -> None:
    """Serve until the program is ended; print the address once the workers are started.

    Raises:
        GraspwatchError: the port, the certificate or the index cannot be used; the text says why.
    """
    from app.api.app import create_app, open_listener
    from app.api.app import serve as serve_app
    from app.http.connection_limiter import reserve_open_files
    from app.people.bind_check import check_certificate, check_listen_address

    server = plan.settings.server
    check_address_space()
    reserve_open_files(server.most_connections)
    check_certificate(server.tls_cert, server.tls_key)
    with contextlib.ExitStack() as unless_served:
        listener = unless_served.enter_context(
            open_listener(host or server.host, server.port if port is None else port)
        )
        address, bound = listener.getsockname()[:2]
        stream_port = None if plan.opened_recordings else plan.settings.foxglove.port
        if stream_port:
            from app.service.foxglove_worker import HOST

            open_listener(HOST, stream_port).close()  # fails now, not in the worker, if the port is taken
        warning = check_listen_address(address, plan.data_folder, server.tls_cert is not None)
        application = create_app(plan)
        unless_served.pop_all()
    scheme = "https" if server.tls_cert else "http"
    names = ", ".join(path.name for path in plan.opened_recordings)
    what = f"replay of {names}" if names else plan.tool.title
    page = _find_first_page(plan)
    error_console.print(f"Graspwatch {__version__}: {what}. Research instrument, not a medical device.", soft_wrap=True)
    if not plan.opened_recordings:
        error_console.print(
            "Preparing the filters; the very first start compiles them, which takes up to a minute.", soft_wrap=True
        )
    if warning:
        error_console.print(warning, style="yellow", soft_wrap=True)
    url = f"{scheme}://{reachable_host(address)}:{bound}"
    stream = f"  (Foxglove: ws://localhost:{stream_port})" if stream_port else ""
    address_line = f"Dashboard: {url}/{page}  (API: {url}/docs){stream}  Ctrl+C ends it."
    serve_app(application, listener, plan, lambda: print(address_line, flush=True))


def _find_first_page(plan: "ServicePlan") -> str:
    """Return the path of the page to open first: the replay of the only recording, the list of several, or live."""
    from app.recordings.catalog import assign_names

    names = list(assign_names(plan.opened_recordings))
    if len(names) == 1:
        return f"recordings/{quote(names[0])}"
    return "recordings" if names else ""
