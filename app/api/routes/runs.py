"""Routes to start, stop and look up runs, and to arm and disarm the tool."""

import asyncio
import contextlib
from http import HTTPStatus
from typing import Annotated, Any

from fastapi import APIRouter, Body, Header, Query, Request, Response
from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from acquisition.protocol_player import ProtocolPlayer
from acquisition.safety_state_machine import Safety
from app.api.dependencies import StartedRunsDep, ToolServiceDep
from app.api.routes.control_lease import acquire_control
from app.http.audit_middleware import note_request
from app.http.pagination import set_paging_headers
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.index.queries import RunQuery
from app.messages.grasps import Grasp
from app.messages.live import Phase, ReferenceState
from app.messages.people import Role
from app.messages.runs import DeclineRequest, Run, RunRequest, SpotRequest, StopAnswer, StopRequest
from app.messages.tool import ArmRequest, SafetyReport
from app.people.authorization import get_user, requester_name, require_role
from app.service.runs import RunUnderWayError
from app.service.tool_service import ToolService
from config.errors import ConfigurationError, RefusedError, ServiceError
from config.load import FileKind, build_graspable_library, list_names, load_grasp_protocol, require_known_name
from config.schema import GraspProtocol, ToolKind

router = APIRouter(prefix="/api", tags=["runs"])
STOP_BODY_TIMEOUT_S = 0.1
IDEMPOTENCY_DESCRIPTION = (
    "A text of your choice, new for each start. A repeat with the same key and body gets the answer of the first "
    "request and starts nothing; with another body it is refused. The service keeps a key for 24 hours, of each person "
    "the last 200, and forgets all when it ends. An error is not kept."
)
STOP_OPENAPI_BODY = {
    "requestBody": {"content": {"application/json": {"schema": {"$ref": "#/components/schemas/StopRequest"}}}}
}
RUN_NOT_FOUND_RESPONSE: dict[int | str, dict[str, Any]] = {404: {"description": "No such run", **PROBLEM_RESPONSE}}


@router.post(
    "/runs",
    dependencies=[require_role(Role.OPERATOR)],
    status_code=HTTPStatus.CREATED,
    responses={
        409: {"description": "A run is under way (`run`), or somebody else has control", **PROBLEM_RESPONSE},
        422: {"description": "A field is at fault, or the key was sent with another body", **PROBLEM_RESPONSE},
        503: {"description": "The tool does not answer", **PROBLEM_RESPONSE},
    },
)
async def start_run(
    request: Request,
    tool_service: ToolServiceDep,
    started_runs: StartedRunsDep,
    body: Annotated[RunRequest, Body()],
    idempotency_key: Annotated[
        str | None, Header(alias="Idempotency-Key", min_length=1, max_length=200, description=IDEMPOTENCY_DESCRIPTION)
    ] = None,
) -> Run:
    """Start a run of a protocol on the tool, and return the run."""
    user = get_user(request)
    started = f"run {body.protocol}" + (f" on {body.tissue}" if body.tissue else "")
    note_request(request, description=f"Repeat the start of {started}, which its first request has answered")

    async def start() -> Run:
        note_request(request, description=f"Start {started}")
        return await _start_run(request, tool_service, body)

    return await started_runs.answer_once(user.name if user else None, idempotency_key, body, start)


async def _start_run(request: Request, tool_service: ToolService, body: RunRequest) -> Run:
    check_has_tool(tool_service)
    override = _unmeasured_scale_reason(request, tool_service, body.unmeasured_scale)
    try:
        folder = tool_service.plan.data_folder
        name = require_known_name(body.protocol, list_names(FileKind.PROTOCOL, folder), "protocol")
        protocol = load_grasp_protocol(name, folder)
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "protocol") from None
    cycles = body.cycles or protocol.cycles
    _check_tissue(tool_service, body.tissue, protocol)
    try:
        ProtocolPlayer(protocol, tool_service.plan.tool, cycles)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), error.field) from None
    acquire_control(request, tool_service)
    by = requester_name(request, body.by)
    try:
        await _end_demo_and_check_idle(tool_service)
        return await tool_service.run_controller.start(
            protocol, cycles, body.tissue or tool_service.runs.simulated_tissue, by, override
        )
    except RunUnderWayError as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error), run=error.run) from None
    except ServiceError as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None


def _unmeasured_scale_reason(request: Request, tool_service: ToolService, reason: str | None) -> str:
    """Return why a tool with an unmeasured force scale may be armed; empty if no reason is given or needed.

    Raises:
        ProblemError: the requester gives a reason, but is no admin.
    """
    if reason is None or tool_service.plan.tool.has_known_scale:
        return ""
    user = get_user(request)
    if user is None or not user.role.includes(Role.ADMIN):
        detail = "Only an admin may arm a tool whose force scale is not measured."
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, detail, "unmeasured_scale")
    return reason


async def _end_demo_and_check_idle(tool_service: ToolService) -> None:
    """End a demonstration that is under way, then refuse the start unless the tool is idle."""
    current = tool_service.runs.current
    if current and tool_service.runs.demo_text:
        await tool_service.run_controller.stop("the demonstration was ended by a run")
        current = tool_service.runs.current
    tool_service.runs.demo_text = None
    if current:
        raise RunUnderWayError(current)
    if tool_service.state.phase is not Phase.IDLE:
        texts = "; ".join(tool_service.alarms.technical_alarm_texts()) or "wait"
        detail = f"The tool is not ready ({tool_service.state.phase.value}): {texts}"
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, detail)


def _check_tissue(tool_service: ToolService, tissue: str | None, protocol: GraspProtocol) -> None:
    if tissue is None:
        return
    if protocol.is_reference_grasp:
        detail = "A reference grasp closes on nothing. Leave `tissue` out."
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, detail, "tissue")
    if tool_service.plan.tool.kind is not ToolKind.SIMULATED:
        detail = "Only the simulated grasper can be told what it holds. Leave `tissue` out."
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, detail, "tissue")
    try:
        require_known_name(tissue, list(build_graspable_library(tool_service.plan.library).tissues), "tissue")
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "tissue") from None


@router.post(
    "/arm",
    dependencies=[require_role(Role.OPERATOR)],
    responses={409: {"description": "It cannot be armed", **PROBLEM_RESPONSE}},
)
async def arm_tool(request: Request, tool_service: ToolServiceDep, body: ArmRequest | None = None) -> SafetyReport:
    """Tare the tool and test it at rest, so that it may move. A start arms it too, unless the settings forbid that."""
    check_has_tool(tool_service)
    body = body or ArmRequest()
    override = _unmeasured_scale_reason(request, tool_service, body.unmeasured_scale)
    acquire_control(request, tool_service)
    await tool_service.arming.arm(requester_name(request, body.by), override)
    return SafetyReport(safety=tool_service.arming.safety)


@router.post(
    "/disarm",
    dependencies=[require_role(Role.OPERATOR)],
    responses={409: {"description": "The tool does not answer", **PROBLEM_RESPONSE}},
)
async def disarm_tool(request: Request, tool_service: ToolServiceDep, body: ArmRequest | None = None) -> SafetyReport:
    """Set the motor to zero and forbid motion until the tool is armed again. A run under way is stopped."""
    check_has_tool(tool_service)
    acquire_control(request, tool_service)
    await tool_service.arming.disarm(requester_name(request, body.by if body else None))
    return SafetyReport(safety=Safety.DISARMED)


@router.post(
    "/spots",
    dependencies=[require_role(Role.OPERATOR)],
    responses={
        409: {"description": "No run is under way, or somebody else has control", **PROBLEM_RESPONSE},
        503: {"description": "The tool does not answer", **PROBLEM_RESPONSE},
    },
)
async def begin_spot(request: Request, tool_service: ToolServiceDep, body: SpotRequest | None = None) -> Run:
    """Begin a new spot in the run: the next grasp is on another place. A grasp under way belongs to the spot before."""
    note_request(request, description="Begin a new spot")
    check_has_tool(tool_service)
    acquire_control(request, tool_service)
    try:
        return await tool_service.run_controller.begin_spot(requester_name(request, body.by if body else None))
    except ServiceError as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None


@router.post(
    "/reference/decline",
    dependencies=[require_role(Role.OPERATOR)],
    responses={409: {"description": "Somebody else has control, or there is no tool", **PROBLEM_RESPONSE}},
)
async def decline_reference(
    request: Request, tool_service: ToolServiceDep, body: DeclineRequest | None = None
) -> ReferenceState:
    """Go on without a reference grasp today: the stall counts less. To take one, start the run `reference_grasp`."""
    note_request(request, description="Go on without a reference grasp")
    check_has_tool(tool_service)
    acquire_control(request, tool_service)
    tool_service.references.decline(requester_name(request, body.by if body else None))
    tool_service.state.publish()
    return tool_service.references.build_state()


def check_has_tool(tool_service: ToolService) -> None:
    """Check that the service has a tool.

    Raises:
        ProblemError: the service only shows recordings.
    """
    if tool_service.plan.opened_recordings:
        raise ProblemError(HTTPStatus.CONFLICT, "This service only shows recordings: there is no tool to run.")


@router.get(
    "/runs", dependencies=[require_role(Role.VIEWER)], responses={503: {"description": "No index", **PROBLEM_RESPONSE}}
)
async def list_runs(
    request: Request, tool_service: ToolServiceDep, response: Response, query: Annotated[RunQuery, Query()]
) -> list[Run]:
    """List runs of this service and earlier ones, oldest first by default; `X-Total-Count` gives their total number."""
    found = await tool_service.index_writer.query(tool_service.index_writer.store.find_runs, query)
    set_paging_headers(request, response, query.limit, query.offset, found.total)
    return [tool_service.runs.get(run.id) or run for run in found.items]


@router.get("/runs/{run_id}", dependencies=[require_role(Role.VIEWER)], responses=RUN_NOT_FOUND_RESPONSE)
async def get_run(tool_service: ToolServiceDep, run_id: str) -> Run:
    """Return one run of this service or an earlier one."""
    run = tool_service.runs.get(run_id) or await tool_service.index_writer.query(
        tool_service.index_writer.store.get_run, run_id
    )
    if run is None:
        raise ProblemError(HTTPStatus.NOT_FOUND, f"There is no run {run_id!r}. See the list of runs.")
    return run


@router.get("/runs/{run_id}/grasps", dependencies=[require_role(Role.VIEWER)], responses=RUN_NOT_FOUND_RESPONSE)
async def list_run_grasps(tool_service: ToolServiceDep, run_id: str) -> list[Grasp]:
    """List the finished grasps of a run."""
    await get_run(tool_service, run_id)
    if tool_service.runs.get(run_id):
        return tool_service.runs.list_grasps(run_id)
    return await tool_service.index_writer.query(tool_service.index_writer.store.list_run_grasps, run_id)


async def _read_requester_name(request: Request) -> str | None:
    """Return the name of the signed-in user, else the name in the body, if a valid body arrives in time."""
    said = None
    with contextlib.suppress(TimeoutError, ValidationError, HTTPException, ClientDisconnect):
        async with asyncio.timeout(STOP_BODY_TIMEOUT_S):
            said = StopRequest.model_validate_json(await request.body() or "{}").by
    return requester_name(request, said)


@router.post(
    "/runs/{run_id}/stop",
    dependencies=[require_role(Role.VIEWER)],
    responses=RUN_NOT_FOUND_RESPONSE,
    openapi_extra=STOP_OPENAPI_BODY,
)
async def stop_run(request: Request, tool_service: ToolServiceDep, run_id: str) -> StopAnswer:
    """Stop this run: the motor goes to zero at once. Stopping a run that has ended changes nothing."""
    current = tool_service.runs.current
    if current is None or current.id != run_id:
        await _read_requester_name(request)  # for the journal
        return StopAnswer(stopped=False, run=await get_run(tool_service, run_id))
    return await _stop_motor(request, tool_service)


@router.post(
    "/stop",
    dependencies=[require_role(Role.VIEWER)],
    responses={503: {"description": "The tool does not answer", **PROBLEM_RESPONSE}},
    openapi_extra=STOP_OPENAPI_BODY,
)
async def stop(request: Request, tool_service: ToolServiceDep) -> StopAnswer:
    """Set the motor to zero at once. This is always allowed, also when no run is under way."""
    return await _stop_motor(request, tool_service)


async def _stop_motor(request: Request, tool_service: ToolService) -> StopAnswer:
    """Stop the motor before reading the body of the request."""
    tool_service.runs.demo_text = None
    before = tool_service.runs.current
    try:
        stopped = await tool_service.run_controller.stop("asked to stop", lambda: _read_requester_name(request))
    except ServiceError as error:
        advice = " Switch the motor's amplifier off by hand." if tool_service.plan.tool.has_motor else ""
        detail = f"{error}{advice}"
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, detail) from None
    run = tool_service.runs.get(before.id) if before else None
    tool_service.state.publish()
    return StopAnswer(stopped=stopped, run=run)
