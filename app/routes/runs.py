"""Runs: start, stop, look up."""

import asyncio
import contextlib
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Body, Query, Request, Response
from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from acquisition.protocol import ProtocolPlayer
from acquisition.safety import Safety
from app.audit.deeds import note_deed
from app.people.roles import needs, signed, who_asks
from app.problems import PROBLEM, ProblemError
from app.routes.control import take_control
from app.routes.paging import tell_page
from app.station import Station
from app.store.questions import RunQuestion
from app.wire import ArmRequest, Grasp, Phase, Role, Run, RunRequest, SafetyReport, StopAnswer, StopRequest
from config.errors import ConfigurationError, RefusedError, ServiceError
from config.load import available, choose, holdable, load_protocol
from config.schema import ToolKind

router = APIRouter(prefix="/api", tags=["runs"])
BODY_S = 0.1
STOP_BODY = {"requestBody": {"content": {"application/json": {"schema": StopRequest.model_json_schema()}}}}
NO_SUCH_RUN = {404: {"description": "No such run", **PROBLEM}}


def station_of(request: Request) -> Station:
    return request.app.state.station


@router.post(
    "/runs",
    dependencies=[needs(Role.OPERATOR)],
    status_code=HTTPStatus.CREATED,
    responses={
        409: {"description": "A run is under way, or somebody else has control", **PROBLEM},
        422: {"description": "A field is at fault", **PROBLEM},
        503: {"description": "The tool does not answer", **PROBLEM},
    },
)
async def start_run(request: Request, wanted: Annotated[RunRequest, Body()]) -> Run:
    """Start a protocol on the tool."""
    note_deed(request, what=f"Start run {wanted.protocol}" + (f" on {wanted.tissue}" if wanted.tissue else ""))
    station = station_of(request)
    check_tool(station)
    override = _override(request, wanted.unmeasured_scale)
    try:
        protocol = load_protocol(choose(wanted.protocol, available("protocols"), "protocol"))
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "protocol") from None
    cycles = wanted.cycles or protocol.cycles
    _check_tissue(station, wanted.tissue)
    try:
        ProtocolPlayer(protocol, station.plan.tool, cycles)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), error.field) from None
    take_control(request)
    await _make_room(station)
    by = signed(request, wanted.by)
    try:
        return await station.start_run(protocol, cycles, wanted.tissue or station.simulated_tissue, by, override)
    except ServiceError as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None


def _override(request: Request, reason: str | None) -> str:
    """Why a tool may be armed whose force scale is not measured; empty where nobody says so or it needs no reason.

    Raises:
        ProblemError: somebody gives a reason who is no admin.
    """
    if reason is None or station_of(request).plan.tool.has_known_scale:
        return ""
    who = who_asks(request)
    if who is None or not who.role.includes(Role.ADMIN):
        detail = "Only an admin may arm a tool whose force scale is not measured."
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, detail, "unmeasured_scale")
    return reason


async def _make_room(station: Station) -> None:
    """A person ends the demonstration by starting a run; any other run under way, or a tool not ready, refuses one."""
    current = station.runs.current
    if current and station.demo:
        await station.stop_run("the demonstration was ended by a run")
        current = station.runs.current
    station.demo = None
    if current:
        raise ProblemError(HTTPStatus.CONFLICT, f"Run {current.id} is under way. Stop it first.")
    if station.phase is not Phase.IDLE:
        detail = (
            f"The tool is not ready ({station.phase.value}): {'; '.join(station.alarms.technical_texts()) or 'wait'}"
        )
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, detail)


def _check_tissue(station: Station, tissue: str | None) -> None:
    if tissue is None:
        return
    if station.plan.tool.kind is not ToolKind.SIMULATED:
        detail = "Only the simulated grasper can be told what it holds. Leave `tissue` out."
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, detail, "tissue")
    try:
        choose(tissue, list(holdable(station.plan.library).tissues), "tissue")
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "tissue") from None


@router.post(
    "/arm", dependencies=[needs(Role.OPERATOR)], responses={409: {"description": "It cannot be armed", **PROBLEM}}
)
async def arm(request: Request, wanted: ArmRequest | None = None) -> SafetyReport:
    """Tare the tool and test it at rest, so that it may move. A start does so itself, unless the settings forbid it."""
    station = station_of(request)
    check_tool(station)
    wanted = wanted or ArmRequest()
    override = _override(request, wanted.unmeasured_scale)
    take_control(request)
    await station.arming.arm(signed(request, wanted.by), override)
    return SafetyReport(safety=station.arming.safety)


@router.post(
    "/disarm",
    dependencies=[needs(Role.OPERATOR)],
    responses={409: {"description": "The tool does not answer", **PROBLEM}},
)
async def disarm(request: Request, wanted: ArmRequest | None = None) -> SafetyReport:
    """Motor to zero, and nothing starts before the tool is armed again; a run under way is stopped."""
    station = station_of(request)
    check_tool(station)
    take_control(request)
    await station.arming.disarm(signed(request, wanted.by if wanted else None))
    return SafetyReport(safety=Safety.DISARMED)


def check_tool(station: Station) -> None:
    """
    Raises:
        ProblemError: there is none.
    """
    if station.plan.opened:
        raise ProblemError(HTTPStatus.CONFLICT, "This service only shows recordings: there is no tool to run.")


@router.get("/runs", dependencies=[needs(Role.VIEWER)], responses={503: {"description": "No index", **PROBLEM}})
async def list_runs(request: Request, response: Response, asked: Annotated[RunQuestion, Query()]) -> list[Run]:
    """Runs of this service and earlier ones, oldest first; how many there are on all is in `X-Total-Count`."""
    station = station_of(request)
    found = await station.index.ask(station.index.store.runs, asked)
    tell_page(request, response, asked.limit, asked.offset, found.total)
    return [station.runs.get(run.id) or run for run in found.items]


@router.get("/runs/{run_id}", dependencies=[needs(Role.VIEWER)], responses=NO_SUCH_RUN)
async def get_run(request: Request, run_id: str) -> Run:
    """One run."""
    station = station_of(request)
    run = station.runs.get(run_id) or await station.index.ask(station.index.store.run, run_id)
    if run is None:
        raise ProblemError(HTTPStatus.NOT_FOUND, f"There is no run {run_id!r}. GET /api/runs lists them.")
    return run


@router.get("/runs/{run_id}/grasps", dependencies=[needs(Role.VIEWER)], responses=NO_SUCH_RUN)
async def get_grasps(request: Request, run_id: str) -> list[Grasp]:
    """The finished grasps of a run."""
    await get_run(request, run_id)
    station = station_of(request)
    if station.runs.get(run_id):
        return station.runs.grasps(run_id)
    return await station.index.ask(station.index.store.grasps_of, run_id)


async def _who_stops(request: Request) -> str | None:
    """Whom the body names, if it names anybody and comes at all."""
    said = None
    with contextlib.suppress(TimeoutError, ValidationError, HTTPException, ClientDisconnect):
        async with asyncio.timeout(BODY_S):
            said = StopRequest.model_validate_json(await request.body() or "{}").by
    return signed(request, said)


@router.post("/runs/{run_id}/stop", dependencies=[needs(Role.VIEWER)], responses=NO_SUCH_RUN, openapi_extra=STOP_BODY)
async def stop_run(request: Request, run_id: str) -> StopAnswer:
    """Stop this run: motor to zero at once. Stopping a run that is over changes nothing."""
    current = station_of(request).runs.current
    if current is None or current.id != run_id:
        await _who_stops(request)  # for the journal
        return StopAnswer(stopped=False, run=await get_run(request, run_id))
    return await _stop(request)


@router.post(
    "/stop",
    dependencies=[needs(Role.VIEWER)],
    responses={503: {"description": "The tool does not answer", **PROBLEM}},
    openapi_extra=STOP_BODY,
)
async def stop(request: Request) -> StopAnswer:
    """Motor to zero at once, whatever runs. Always allowed, also when nothing runs."""
    return await _stop(request)


async def _stop(request: Request) -> StopAnswer:
    """The motor first; then whatever stands in the request is read."""
    station = station_of(request)
    station.demo = None
    before = station.runs.current
    try:
        stopped = await station.stop_run("asked to stop", lambda: _who_stops(request))
    except ServiceError as error:
        detail = f"{error} Switch the motor's amplifier off by hand."
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, detail) from None
    run = station.runs.get(before.id) if before else None
    station.tell_state()
    return StopAnswer(stopped=stopped, run=run)
