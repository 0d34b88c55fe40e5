"""Routes for the tool, its protocols, the tissue library, and the service's health and metrics."""

import functools

import numpy as np
from fastapi import APIRouter, Request, Response
from pydantic import TypeAdapter

from acquisition.protocol_player import command_cycle
from app import __version__
from app.api.dependencies import ToolServiceDep
from app.messages.live import Phase
from app.messages.people import Role
from app.messages.system import Health
from app.messages.tool import LibraryInfo, ProtocolInfo, ToolInfo
from app.people.authorization import PUBLIC_ROUTE, get_user, require_role
from app.stream.descriptions import build_library_info, build_tool_info
from config.errors import RefusedError
from config.load import list_shipped_names, load_grasp_protocol, read_modification_times
from config.schema import GraspProtocol, Tool

router = APIRouter(tags=["tool"])
MAX_PREVIEW_POINTS = 200


@router.get(
    "/api/health",
    dependencies=[PUBLIC_ROUTE],
    responses={503: {"model": Health, "description": "Starting, or faulted"}},
)
async def get_health(request: Request, tool_service: ToolServiceDep, response: Response) -> Health:
    """Return the service's health: ready once the filters are compiled and samples arrive."""
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
    """Return the tool in use."""
    return build_tool_info(tool_service.plan.tool)


@router.get("/api/protocols", dependencies=[require_role(Role.VIEWER)], response_model=list[ProtocolInfo])
async def list_protocols(tool_service: ToolServiceDep) -> Response:
    """List the protocols, shortest cycle first, each with its waveform for a preview."""
    # a frozen model can be hashed, which the checker does not learn from `model_config`
    previews = _build_previews(
        tool_service.plan.tool,  # pyright: ignore[reportArgumentType]
        read_modification_times("protocols"),
    )
    return Response(previews, media_type="application/json")


@functools.lru_cache(maxsize=2)
def _build_previews(tool: Tool, stamp_ns: tuple[int, ...]) -> bytes:
    """Build the previews as JSON, cached until a file changes: many requests must not delay a STOP."""
    result = [_build_preview(load_grasp_protocol(name), tool) for name in list_shipped_names("protocols")]
    result.sort(key=lambda protocol: (protocol.cycle_s, protocol.name))
    return TypeAdapter(list[ProtocolInfo]).dump_json(result)


def _build_preview(protocol: GraspProtocol, tool: Tool) -> ProtocolInfo:
    refused, command = None, np.zeros(0)
    try:
        command = command_cycle(protocol, tool)
    except RefusedError as error:
        refused = str(error)
    thin = max(len(command) // MAX_PREVIEW_POINTS, 1)
    return ProtocolInfo(
        name=protocol.name,
        title=protocol.title,
        cycles=protocol.cycles,
        cycle_s=protocol.waveform.cycle_s,
        peak_command_v=float(command.max(initial=0.0)),
        refused=refused,
        time_s=[i / tool.board.sample_rate_hz for i in range(0, len(command), thin)],
        command_v=command[::thin].tolist(),
    )


@router.get("/api/tissues", dependencies=[require_role(Role.VIEWER)])
async def get_tissue_library(tool_service: ToolServiceDep) -> LibraryInfo:
    """Return the tissue library in use."""
    return build_library_info(tool_service.plan)


@router.get("/metrics", dependencies=[require_role(Role.VIEWER)], include_in_schema=False)
async def get_metrics(tool_service: ToolServiceDep) -> Response:
    """Return Prometheus metrics."""
    return Response(tool_service.state.render_metrics(), media_type="text/plain; version=0.0.4; charset=utf-8")
