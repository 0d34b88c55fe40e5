"""`graspwatch support`: a file without secrets for a person who is asked for help."""

import json
import os
import platform
import re
import resource
import ssl
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import distributions
from pathlib import Path
from typing import Annotated, Any

import typer

from app import __version__
from app.audit.chain_check import check_journal
from app.cli.console import error_console
from app.cli.options import ConfigOption, DataOption, ToolOption, explain_write_errors, find_data_folder
from app.host.disk import free_bytes
from app.host.logs import LOG_FILE
from app.host.logs import LOG_FOLDER as LOGS
from app.people import tokens
from config.atomic_write import open_atomically
from config.errors import GraspwatchError
from config.load import load_library, load_settings, load_tool
from config.network import is_this_computer, reachable_host
from config.schema import Settings

REDACTED = "(hidden)"
TOKEN_PATTERN = re.compile(rf"{tokens.TOKEN_PREFIX}[\w-]{{16,}}")  # hidden, should a part hold a token by mistake
ANSWER_TIMEOUT_S = 5.0
SERVICE_ENDPOINTS = {
    "health.json": "/api/health",
    "system.json": "/api/system",
    "alarms.json": "/api/alarms",
    "metrics.txt": "/metrics",
}
ENVIRONMENT_PREFIXES = ("GRASPWATCH_", "NUMBA_", "PYTHON", "OMP_", "OPENBLAS_")
README_TEXT = (
    "What Graspwatch is and how it stands, for somebody who helps: versions, machine, settings, tool, library, the "
    "last logs, whether journal and index are sound, and what the running service says of itself.\n\n"
    "It holds no token, no password, no sample and no recording. It does hold the names of those who used the tool and "
    "what they did (logs/): look through it before you send it.\n"
)


def support(
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.zip", help="Where to; default: graspwatch-support-TIME.zip here.")
    ] = None,
    url: Annotated[
        str | None, typer.Option(metavar="URL", help="Of the running service; default: as configured, on this machine.")
    ] = None,
    token: Annotated[
        str | None,
        typer.Option(envvar="GRASPWATCH_TOKEN", metavar="TOKEN", help="A viewer's, where the service asks for one."),
    ] = None,
    tool: ToolOption = None,
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """Write a file for whoever is asked for help: versions, settings without secrets, logs, health.

    Example: graspwatch support --out help.zip
    """
    settings = load_settings(config)
    folder = find_data_folder(data, settings)
    path = out or Path(f"graspwatch-support-{datetime.now(UTC):%Y%m%d-%H%M%S}.zip")
    server = settings.server
    scheme = "https" if server.tls_cert else "http"
    address = url or f"{scheme}://{reachable_host(server.host)}:{server.port}"
    parts = {"README.txt": README_TEXT} | _collect_local(settings, tool, folder) | _collect_service(address, token)
    for file in sorted((folder / LOGS).glob(f"{LOG_FILE}*")):
        parts[f"{LOGS}/{file.name}"] = file.read_text(encoding="utf-8", errors="replace")
    with (
        explain_write_errors(path),
        open_atomically(path, overwrite=False) as file,
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as bundle,
    ):
        for name, content in parts.items():
            bundle.writestr(name, TOKEN_PATTERN.sub(REDACTED, content))
    error_console.print(README_TEXT, soft_wrap=True)
    print(path)


def _collect_local(settings: Settings, tool: str | None, data: Path) -> dict[str, str]:
    """Collect the parts that need no service; a part that cannot be read says why instead."""
    wanted: dict[str, Callable[[], Any]] = {
        "about.json": _describe_system,
        "settings.json": lambda: settings.model_dump(mode="json"),
        "tool.json": lambda: load_tool(tool or settings.tool, data).model_dump(mode="json"),
        "library.json": lambda: load_library(settings.library, data).model_dump(mode="json"),
        "data.json": lambda: _describe_data(data),
        "journal.json": lambda: check_journal(data, ()).model_dump(mode="json"),
        "index.json": lambda: _describe_index(settings, data),
    }
    parts = {}
    for name, tell in wanted.items():
        try:
            parts[name] = json.dumps(tell(), indent=2, ensure_ascii=False, default=str)
        except (GraspwatchError, OSError) as error:
            parts[f"{name}.txt"] = f"It could not be found out: {error}\n"
    return parts


def _describe_index(settings: Settings, data: Path) -> dict[str, Any]:
    from app.index.database import index_url_from_settings
    from app.index.status import read_status
    from app.recordings.index_reader import RECORDING_READERS

    return asdict(read_status(index_url_from_settings(settings, data), data, RECORDING_READERS))


def _describe_system() -> dict[str, Any]:
    limits = {"RTPRIO": resource.RLIMIT_RTPRIO, "MEMLOCK": resource.RLIMIT_MEMLOCK, "NOFILE": resource.RLIMIT_NOFILE}
    return {
        "at": datetime.now(UTC).isoformat(timespec="seconds"),
        "graspwatch": __version__,
        "python": platform.python_version(),
        "machine": platform.platform(),
        "cores": os.cpu_count(),
        "memory_bytes": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        "limits": {name: resource.getrlimit(number) for name, number in limits.items()},
        "variables": {
            name: REDACTED if "TOKEN" in name else value
            for name, value in sorted(os.environ.items())
            if name.startswith(ENVIRONMENT_PREFIXES)
        },
        "packages": dict(sorted((each.metadata["Name"], each.version) for each in distributions())),
    }


def _describe_data(data: Path) -> dict[str, Any]:
    recordings = sorted((data / "recordings").glob("*.mcap"))
    people = tokens.read_tokens(data)
    return {
        "folder": str(data),
        "free_bytes": free_bytes(data),
        "recordings": {path.name: path.stat().st_size for path in recordings},
        "people": Counter(each.role.value for each in people if each.is_valid),
    }


def _collect_service(url: str, token: str | None) -> dict[str, str]:
    """Collect what the running service answers, or why it does not answer."""
    import httpx  # imported here because it takes a tenth of a second

    parts = {}
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    direct = is_this_computer(httpx.URL(url).host)  # a proxy must not see the token
    trust = ssl.create_default_context()
    with httpx.Client(
        base_url=url, headers=headers, timeout=ANSWER_TIMEOUT_S, verify=trust, trust_env=not direct
    ) as service:
        for name, path in SERVICE_ENDPOINTS.items():
            try:
                answer = service.get(path)
            except (httpx.HTTPError, ssl.SSLError) as error:
                parts[f"service/{name}.txt"] = f"Nobody answers at {url}{path}: {error}\n"
            else:
                parts[f"service/{name}"] = answer.text
    return parts
