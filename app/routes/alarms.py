"""Alarms that are on, their acknowledgement, and the journal."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Query, Request

from app.people.roles import needs, signed_by
from app.problems import PROBLEM, ProblemError
from app.routes.runs import station_of
from app.wire import AcknowledgeRequest, Alarm, JournalEntry, Role
from config.errors import RefusedError

router = APIRouter(prefix="/api", tags=["alarms"])


@router.get("/alarms", dependencies=[needs(Role.VIEWER)])
async def alarms(request: Request) -> list[Alarm]:
    """Alarms whose cause is there, and those that stay until somebody has acknowledged them."""
    return station_of(request).alarms.all()


@router.post(
    "/alarms/{alarm_id}/acknowledge",
    dependencies=[needs(Role.OPERATOR)],
    responses={404: {"description": "No such alarm", **PROBLEM}, 409: {"description": "Worse by now", **PROBLEM}},
)
async def acknowledge(request: Request, alarm_id: str, wanted: AcknowledgeRequest) -> Alarm:
    """Somebody has seen an alarm: it falls silent on every page, and stays in sight until its cause is gone."""
    by = signed_by(request, wanted.by)
    try:
        return await station_of(request).arming.acknowledge(alarm_id, wanted.priority, by)
    except RefusedError as error:
        status = HTTPStatus.NOT_FOUND if error.field == "id" else HTTPStatus.CONFLICT
        raise ProblemError(status, str(error)) from None


@router.get("/journal", dependencies=[needs(Role.VIEWER)])
async def journal(request: Request, most: Annotated[int, Query(ge=1, le=2000)] = 200) -> list[JournalEntry]:
    """What happened and who did it since the service started, newest first."""
    return station_of(request).journal.newest(most)
