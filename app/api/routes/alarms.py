"""Routes for current alarms, their acknowledgement, and the journal."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Query, Request

from app.api.dependencies import ToolServiceDep
from app.http.audit_middleware import note_request
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.messages.alarms import AcknowledgeRequest, Alarm
from app.messages.journal import JournalEntry
from app.messages.people import Role
from app.people.authorization import require_requester_name, require_role
from config.errors import RefusedError

router = APIRouter(prefix="/api", tags=["alarms"])


@router.get("/alarms", dependencies=[require_role(Role.VIEWER)])
async def list_alarms(tool_service: ToolServiceDep) -> list[Alarm]:
    """List alarms whose cause is present, and latched alarms that were not acknowledged."""
    return tool_service.alarms.current_alarms()


@router.post(
    "/alarms/{alarm_id}/acknowledge",
    dependencies=[require_role(Role.OPERATOR)],
    responses={
        404: {"description": "No such alarm", **PROBLEM_RESPONSE},
        409: {"description": "Worse by now", **PROBLEM_RESPONSE},
    },
)
async def acknowledge_alarm(
    request: Request, tool_service: ToolServiceDep, alarm_id: str, body: AcknowledgeRequest
) -> Alarm:
    """Acknowledge an alarm, and return it. Every page silences it, and shows it until its cause is gone."""
    note_request(request, description=f"Acknowledge {alarm_id}")
    by = require_requester_name(request, body.by)
    try:
        return await tool_service.arming.acknowledge(alarm_id, body.priority, by)
    except RefusedError as error:
        status = HTTPStatus.NOT_FOUND if error.field == "id" else HTTPStatus.CONFLICT
        raise ProblemError(status, str(error)) from None


@router.get("/journal", dependencies=[require_role(Role.VIEWER)])
async def list_journal(
    tool_service: ToolServiceDep, most: Annotated[int, Query(ge=1, le=2000)] = 200
) -> list[JournalEntry]:
    """List what happened and who did it since the service started, newest first."""
    return tool_service.journal.newest_entries(most)
