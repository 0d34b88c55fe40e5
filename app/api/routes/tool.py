"""Routes for the tool, its protocols, the tissue library, and the service's health and metrics."""

import functools
import threading
from pathlib import Path

from fastapi import APIRouter, Request, Response
from pydantic import TypeAdapter

from app import __version__
from app.api.dependencies import ConfigurationFilesDep, ToolServiceDep
from app.messages.live import Phase
from app.messages.people import Role
from app.messages.system import Health
from app.messages.tool import LibraryInfo, ProtocolInfo, ToolInfo
from app.people.authorization import PUBLIC_ROUTE, get_user, require_role
from app.service.configuration_files import MAX_FILES
from app.stream.descriptions import build_library_info, build_protocol_info, build_tool_info
from config.errors import ConfigurationError
from config.load import load_file
from config.schema import GraspProtocol, Tool

router = APIRouter(tags=["tool"])


@router.get(
    "/api/health",
    dependencies=[PUBLIC_ROUTE],
    responses={503: {"model": Health, "description": "Starting, or faulted"}},
)
async def get_health(request: Request, tool_service: ToolServiceDep, response: Response) -> Health:
    """Return the service's health. It is ready once the filters are compiled and samples arrive."""
    workers = tool_service.state.worker_conditions()
    phase = tool_service.state.phase
    if phase is Phase.FAULTED:
        texts = tool_service.alarms.technical_alarm_texts()
        status, detail = "faulted", tool_service.tasks.internal_error or "; ".join(texts) or "a worker is down"
    elif phase is Phase.STARTING:
        texts = tool_service.alarms.technical_alarm_texts()
        waiting_for = "opening the tool" if tool_service.supervisor.tool_may_open else "preparing the filters"
        status, detail = "starting", "; ".join(texts) or waiting_for
    else:
        status, detail = "ready", phase.value
    response.status_code = 200 if status == "ready" else 503
    if get_user(request) is None:
        return Health(status=status, version=None, workers={}, detail="Sign in to learn more.")
    return Health(status=status, version=__version__, workers=workers, detail=detail)


@router.get("/api/tool", dependencies=[require_role(Role.VIEWER)])
async def get_tool(tool_service: ToolServiceDep) -> ToolInfo:
    """Return the tool in use: its title, kind, limits and calibration."""
    return build_tool_info(tool_service.plan.tool)


@router.get("/api/protocols", dependencies=[require_role(Role.VIEWER)], response_model=list[ProtocolInfo])
def list_protocols(tool_service: ToolServiceDep, configuration_files: ConfigurationFilesDep) -> Response:
    """List the shipped and own protocols, also those that this tool refuses, each with a preview; shortest first."""
    plan = tool_service.plan
    files = configuration_files.list_readable_protocols()
    with _PREVIEWS_LOCK:
        # a frozen model can be hashed, which the checker does not learn from `model_config`
        previews = _build_previews(plan.tool, files)  # pyright: ignore[reportArgumentType]
    return Response(previews, media_type="application/json")


_PREVIEWS_LOCK = threading.Lock()  # requests that come together wait for one computation


@functools.lru_cache(maxsize=2)
def _build_previews(tool: Tool, stamped_files: tuple[tuple[Path, int], ...]) -> bytes:
    """Build the previews as JSON, cached until a file changes: many requests must not delay a STOP."""
    previews = [_build_preview(tool, *file) for file in stamped_files]  # pyright: ignore[reportArgumentType]  as above
    result = [preview for preview in previews if preview]
    result.sort(key=lambda protocol: (protocol.cycle_s, protocol.name))
    return TypeAdapter(list[ProtocolInfo]).dump_json(result)


@functools.lru_cache(maxsize=2 * MAX_FILES)
def _build_preview(tool: Tool, path: Path, stamp: int) -> ProtocolInfo | None:
    """Build the preview of one file; None if it was deleted or damaged meanwhile, or is not for such a tool."""
    try:
        protocol = load_file(path, GraspProtocol)
        return build_protocol_info(protocol, tool) if protocol.is_for(tool) else None
    except ConfigurationError:
        return None


@router.get("/api/tissues", dependencies=[require_role(Role.VIEWER)])
async def get_tissue_library(tool_service: ToolServiceDep) -> LibraryInfo:
    """Return the tissue library in use."""
    return build_library_info(tool_service.plan.library)


@router.get("/metrics", dependencies=[require_role(Role.VIEWER)], include_in_schema=False)
async def get_metrics(tool_service: ToolServiceDep) -> Response:
    """Return the service's metrics in the text format of Prometheus."""
    return Response(tool_service.state.render_metrics(), media_type="text/plain; version=0.0.4; charset=utf-8")
