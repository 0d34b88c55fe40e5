"""Control of the tool: who has it, taking it, taking it over, giving it back."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Body, Request

from app.people.roles import needs, who_asks
from app.problems import PROBLEM, ProblemError
from app.station import Station
from app.wire import ControlInfo, ControlRequest, JournalKind, Role
from config.errors import RefusedError

router = APIRouter(prefix="/api/control", tags=["control"])
NO_NEED = "Without tokens nobody needs control. Make them with `graspwatch token add NAME --role operator`."


def take_control(request: Request, *, over: bool = False) -> None:
    """Have whoever asks in control before he moves the tool. Without tokens nobody needs to be.

    Raises:
        ProblemError: somebody else has control.
    """
    who, station = who_asks(request), _station(request)
    if who is None or who.name is None:
        return
    try:
        before = station.control.take(who.name, over=over)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    if before != who.name:
        taken = f"Control taken over from {before}" if before else "Control taken"
        station.tell_event(taken, JournalKind.ACCESS, who.name)
        station.tell_state()


@router.get("", dependencies=[needs(Role.VIEWER)])
async def control(request: Request) -> ControlInfo:
    """Who has control."""
    lease = _station(request).control
    return ControlInfo(holder=lease.holder, expires_in_s=lease.expires_in_s)


@router.post(
    "",
    dependencies=[needs(Role.OPERATOR)],
    responses={409: {"description": "Somebody else has it, or nobody needs it", **PROBLEM}},
)
async def take(request: Request, wanted: Annotated[ControlRequest, Body()]) -> ControlInfo:
    """Take control, or keep it for longer. A start does the same; only this can take it over from somebody else."""
    _check_needed(request)
    take_control(request, over=wanted.take_over)
    return await control(request)


@router.delete(
    "",
    dependencies=[needs(Role.OPERATOR)],
    responses={409: {"description": "Somebody else has it, or nobody needs it", **PROBLEM}},
)
async def give_back(request: Request) -> ControlInfo:
    """Give control back. Who does not have it changes nothing, unless somebody else does."""
    name, station = _check_needed(request), _station(request)
    if not station.give_back_control(name) and station.control.holder:
        raise ProblemError(HTTPStatus.CONFLICT, f"{station.control.holder} has control, and only he can give it back.")
    return await control(request)


def _check_needed(request: Request) -> str:
    """The name of whoever asks."""
    who = who_asks(request)
    if who is None or who.name is None:
        raise ProblemError(HTTPStatus.CONFLICT, NO_NEED)
    return who.name


def _station(request: Request) -> Station:
    return request.app.state.station
