"""Calibration of the tool, reading by reading."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Body, Request

from app.audit.deeds import note_deed
from app.bench.desk import CalibrationDesk
from app.people.roles import needs, signed
from app.problems import PROBLEM, ProblemError
from app.routes.control import take_control
from app.routes.runs import check_tool, station_of
from app.wire import Calibration, CalibrationRequest, Role
from config.errors import CalibrationError, ConfigurationError, RefusedError, ServiceError

router = APIRouter(prefix="/api/calibration", tags=["calibration"])
BUSY = {409: {"description": "Not now, or it cannot be trusted; the text says what to do", **PROBLEM}}


def _desk(request: Request) -> CalibrationDesk:
    return request.app.state.calibration


@router.get("", dependencies=[needs(Role.VIEWER)])
async def calibration(request: Request) -> Calibration:
    """The calibration under way, or the last one."""
    return _desk(request).state


@router.post(
    "",
    dependencies=[needs(Role.OPERATOR)],
    status_code=HTTPStatus.CREATED,
    responses=BUSY | {503: {"description": "The new tool file could not be written", **PROBLEM}},
)
async def begin(request: Request, wanted: Annotated[CalibrationRequest, Body()]) -> Calibration:
    """Begin one. Nothing moves yet."""
    note_deed(request, what=f"Begin calibration of {wanted.what}")
    check_tool(station_of(request))
    take_control(request)
    try:
        _desk(request).begin(wanted)
    except CalibrationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "values") from None
    except RefusedError as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None
    return _desk(request).state


@router.post(
    "/reading",
    dependencies=[needs(Role.OPERATOR)],
    responses=BUSY | {503: {"description": "The tool does not answer", **PROBLEM}},
)
async def read(request: Request) -> Calibration:
    """Take the next reading; answers when it is taken. For `stretch` and `geometry` the jaws close gently."""
    note_deed(request, what="Take a reading for a calibration")
    check_tool(station_of(request))
    take_control(request)
    try:
        await _desk(request).read(signed(request, None))
    except (CalibrationError, RefusedError) as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    except (ServiceError, ConfigurationError) as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None
    return _desk(request).state


@router.delete("", dependencies=[needs(Role.OPERATOR)], responses=BUSY)
async def abandon(request: Request) -> Calibration:
    """Forget the one under way. Nothing is written."""
    check_tool(station_of(request))
    take_control(request)
    try:
        _desk(request).abandon()
    except RefusedError as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    return _desk(request).state
