"""Routes to calibrate the tool, one reading at a time."""

from http import HTTPStatus
from typing import Annotated, Any

from fastapi import APIRouter, Body, Request

from app.api.dependencies import CalibrationDep, ToolServiceDep
from app.api.routes.control_lease import acquire_control
from app.api.routes.runs import check_has_tool
from app.http.audit_middleware import note_request
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.messages.calibration import Calibration, CalibrationRequest
from app.messages.people import Role
from app.people.authorization import requester_name, require_role
from config.errors import CalibrationError, ConfigurationError, RefusedError, ServiceError

router = APIRouter(prefix="/api/calibration", tags=["calibration"])
CONFLICT_RESPONSE: dict[int | str, dict[str, Any]] = {
    409: {"description": "Not now, or it cannot be trusted; the text says what to do", **PROBLEM_RESPONSE}
}


@router.get("", dependencies=[require_role(Role.VIEWER)])
async def get_calibration(calibration_session: CalibrationDep) -> Calibration:
    """Return the calibration of the tool that is under way, or the last one."""
    return calibration_session.state


@router.post(
    "",
    dependencies=[require_role(Role.OPERATOR)],
    status_code=HTTPStatus.CREATED,
    responses=CONFLICT_RESPONSE | {503: {"description": "The new tool file could not be written", **PROBLEM_RESPONSE}},
)
async def begin_calibration(
    request: Request,
    calibration_session: CalibrationDep,
    tool_service: ToolServiceDep,
    body: Annotated[CalibrationRequest, Body()],
) -> Calibration:
    """Begin a calibration of the tool, and return it. The tool does not move yet."""
    note_request(request, description=f"Begin calibration of {body.what}")
    check_has_tool(tool_service)
    acquire_control(request, tool_service)
    try:
        calibration_session.begin(body)
    except CalibrationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "values") from None
    except RefusedError as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None
    return calibration_session.state


@router.post(
    "/reading",
    dependencies=[require_role(Role.OPERATOR)],
    responses=CONFLICT_RESPONSE | {503: {"description": "The tool does not answer", **PROBLEM_RESPONSE}},
)
async def take_calibration_reading(
    request: Request, calibration_session: CalibrationDep, tool_service: ToolServiceDep
) -> Calibration:
    """Take the calibration's next reading, then return it. For `stretch` and `geometry` the jaws close gently."""
    note_request(request, description="Take a reading for a calibration")
    check_has_tool(tool_service)
    acquire_control(request, tool_service)
    try:
        await calibration_session.take_reading(requester_name(request, None))
    except (CalibrationError, RefusedError) as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    except (ServiceError, ConfigurationError) as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None
    return calibration_session.state


@router.delete("", dependencies=[require_role(Role.OPERATOR)], responses=CONFLICT_RESPONSE)
async def discard_calibration(
    request: Request, calibration_session: CalibrationDep, tool_service: ToolServiceDep
) -> Calibration:
    """Discard the calibration under way. No tool file is written."""
    check_has_tool(tool_service)
    acquire_control(request, tool_service)
    try:
        calibration_session.discard()
    except RefusedError as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    return calibration_session.state
