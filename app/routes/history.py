"""What has happened, also before this service: grasps, alarms, audit and files, from the index."""

from typing import Annotated, TypeVar

from fastapi import APIRouter, Query, Request, Response

from app.people.roles import needs
from app.problems import PROBLEM
from app.routes.paging import tell_page
from app.routes.runs import station_of
from app.store.questions import AlarmQuestion, AuditQuestion, FileQuestion, GraspQuestion, Question
from app.store.store import Found
from app.wire import Alarm, FileRecord, GraspEnded, JournalEntry, Role

router = APIRouter(prefix="/api", tags=["history"], responses={503: {"description": "No index", **PROBLEM}})
T = TypeVar("T")


@router.get("/grasps", dependencies=[needs(Role.VIEWER)])
async def grasps(request: Request, response: Response, asked: Annotated[GraspQuestion, Query()]) -> list[GraspEnded]:
    """Grasps of all runs, newest first."""
    found = await station_of(request).index.ask(station_of(request).index.store.grasps, asked)
    return _page(request, response, asked, found)


@router.get("/alarms/history", dependencies=[needs(Role.VIEWER)])
async def alarms(request: Request, response: Response, asked: Annotated[AlarmQuestion, Query()]) -> list[Alarm]:
    """Alarms that were on or are, each as it was last, newest first."""
    found = await station_of(request).index.ask(station_of(request).index.store.alarms, asked)
    return _page(request, response, asked, found)


@router.get("/audit", dependencies=[needs(Role.VIEWER)])
async def audit(request: Request, response: Response, asked: Annotated[AuditQuestion, Query()]) -> list[JournalEntry]:
    """Every line of the journal, newest first: what happened and who did it."""
    found = await station_of(request).index.ask(station_of(request).index.store.audit, asked)
    return _page(request, response, asked, found)


@router.get("/files", dependencies=[needs(Role.VIEWER)])
async def files(request: Request, response: Response, asked: Annotated[FileQuestion, Query()]) -> list[FileRecord]:
    """Recordings of runs, newest first, also deleted ones with who deleted them."""
    found = await station_of(request).index.ask(station_of(request).index.store.files, asked)
    return _page(request, response, asked, found)


def _page(request: Request, response: Response, asked: Question, found: Found[T]) -> list[T]:
    tell_page(request, response, asked.limit, asked.offset, found.total)
    return found.items
