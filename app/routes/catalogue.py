"""What there is: the tool, its protocols, the tissue library, the service's health and metrics."""

import functools

import numpy as np
from fastapi import APIRouter, Request, Response
from pydantic import TypeAdapter

from acquisition.protocol import command_cycle
from app import __version__
from app.describe import library_info, tool_info
from app.people.roles import ANYBODY, needs, who_asks
from app.routes.runs import station_of
from app.wire import Health, LibraryInfo, Phase, ProtocolInfo, Role, ToolInfo
from config.errors import RefusedError
from config.load import available, load_protocol, stamp
from config.schema import Protocol, Tool

router = APIRouter(tags=["catalogue"])
PREVIEW_POINTS = 200


@router.get(
    "/api/health", dependencies=[ANYBODY], responses={503: {"model": Health, "description": "Starting, or faulted"}}
)
async def health(request: Request, response: Response) -> Health:
    """Ready once the filters are compiled and samples arrive."""
    station = request.app.state.station
    workers = station.conditions()
    phase = station.phase
    if phase is Phase.FAULTED:
        texts = station.alarms.technical_texts()
        status, detail = "faulted", station.internal_error or "; ".join(texts) or "a worker is down"
    elif phase is Phase.STARTING:
        texts = station.alarms.technical_texts()
        waiting_for = "opening the tool" if station.estimator_ready.is_set() else "preparing the filters"
        status, detail = "starting", "; ".join(texts) or waiting_for
    else:
        status, detail = "ready", phase.value
    response.status_code = 200 if status == "ready" else 503
    if who_asks(request) is None:
        return Health(status=status, version=None, workers={}, detail="Sign in to learn more.")
    return Health(status=status, version=__version__, workers=workers, detail=detail)


@router.get("/api/tool", dependencies=[needs(Role.VIEWER)])
async def tool(request: Request) -> ToolInfo:
    """The tool in use."""
    return tool_info(station_of(request).plan.tool)


@router.get("/api/protocols", dependencies=[needs(Role.VIEWER)], response_model=list[ProtocolInfo])
async def protocols(request: Request) -> Response:
    """The protocols, the shortest first, each with its waveform for a preview."""
    return Response(_previews(station_of(request).plan.tool, stamp("protocols")), media_type="application/json")


@functools.lru_cache(maxsize=2)
def _previews(tool: Tool, stamp_ns: tuple[int, ...]) -> bytes:
    """Worked out once for the files as they are: a storm of requests must not hold up a STOP."""
    result = [_preview(load_protocol(name), tool) for name in available("protocols")]
    result.sort(key=lambda protocol: (protocol.cycle_s, protocol.name))
    return TypeAdapter(list[ProtocolInfo]).dump_json(result)


def _preview(protocol: Protocol, tool: Tool) -> ProtocolInfo:
    refused, command = None, np.zeros(0)
    try:
        command = command_cycle(protocol, tool)
    except RefusedError as error:
        refused = str(error)
    thin = max(len(command) // PREVIEW_POINTS, 1)
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


@router.get("/api/tissues", dependencies=[needs(Role.VIEWER)])
async def tissues(request: Request) -> LibraryInfo:
    """The tissue library in use."""
    return library_info(station_of(request).plan)


@router.get("/metrics", dependencies=[needs(Role.VIEWER)], include_in_schema=False)
async def metrics(request: Request) -> Response:
    """Prometheus metrics."""
    return Response(station_of(request).measured(), media_type="text/plain; version=0.0.4; charset=utf-8")
