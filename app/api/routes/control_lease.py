"""Routes for control of the tool, a lease of one operator at a time: read, acquire, take over, release."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Body, Request

from app.api.dependencies import ToolServiceDep
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.messages.journal import JournalKind
from app.messages.people import ControlInfo, ControlRequest, Role
from app.people.authorization import get_user, require_role
from app.service.tool_service import ToolService
from config.errors import RefusedError

router = APIRouter(prefix="/api/control", tags=["control"])
NO_TOKENS_TEXT = "Without tokens nobody needs control. Make them with `graspwatch token add NAME --role operator`."


def acquire_control(request: Request, tool_service: ToolService, *, take_over: bool = False) -> None:
    """Acquire the control lease for the caller. A service without tokens needs none.

    Raises:
        ProblemError: another user has control.
    """
    user = get_user(request)
    if user is None or user.name is None:
        return
    try:
        before = tool_service.control_lease.acquire(user.name, take_over=take_over)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    if before != user.name:
        taken = f"Control taken over from {before}" if before else "Control taken"
        tool_service.publisher.publish_event(taken, JournalKind.ACCESS, user.name)
        tool_service.state.publish()


@router.get("", dependencies=[require_role(Role.VIEWER)])
async def get_control(tool_service: ToolServiceDep) -> ControlInfo:
    """Return which operator has control of the tool."""
    lease = tool_service.control_lease
    return ControlInfo(holder=lease.holder, expires_in_s=lease.expires_in_s)


@router.post(
    "",
    dependencies=[require_role(Role.OPERATOR)],
    responses={409: {"description": "Somebody else has it, or nobody needs it", **PROBLEM_RESPONSE}},
)
async def take_control(
    request: Request, tool_service: ToolServiceDep, body: Annotated[ControlRequest, Body()]
) -> ControlInfo:
    """Acquire or extend control of the tool. A start does so too, but only this request takes it from another user."""
    _require_user_name(request)
    acquire_control(request, tool_service, take_over=body.take_over)
    return await get_control(tool_service)


@router.delete(
    "",
    dependencies=[require_role(Role.OPERATOR)],
    responses={409: {"description": "Somebody else has it, or nobody needs it", **PROBLEM_RESPONSE}},
)
async def release_control(request: Request, tool_service: ToolServiceDep) -> ControlInfo:
    """Release control of the tool. The request is refused if another user has control."""
    name = _require_user_name(request)
    if not tool_service.release_control(name) and tool_service.control_lease.holder:
        holder = tool_service.control_lease.holder
        raise ProblemError(HTTPStatus.CONFLICT, f"{holder} has control. Only {holder} can release it.")
    return await get_control(tool_service)


def _require_user_name(request: Request) -> str:
    """Return the user's name; raises `ProblemError` if the service has no tokens, and so no names."""
    user = get_user(request)
    if user is None or user.name is None:
        raise ProblemError(HTTPStatus.CONFLICT, NO_TOKENS_TEXT)
    return user.name
