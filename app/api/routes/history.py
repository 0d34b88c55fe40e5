"""Routes that query the index, which covers earlier services too: grasps, alarms, journal lines and recordings."""

from typing import Annotated, TypeVar

from fastapi import APIRouter, Query, Request, Response

from app.api.dependencies import ToolServiceDep
from app.http.pagination import set_paging_headers
from app.http.problems import PROBLEM_RESPONSE
from app.index.queries import AlarmQuery, AuditQuery, FileQuery, GraspQuery, PageQuery
from app.index.store import Page
from app.messages.alarms import Alarm
from app.messages.grasps import GraspEnded
from app.messages.journal import JournalEntry
from app.messages.people import Role
from app.messages.recordings import FileRecord
from app.people.authorization import require_role

router = APIRouter(prefix="/api", tags=["history"], responses={503: {"description": "No index", **PROBLEM_RESPONSE}})
T = TypeVar("T")


@router.get("/grasps", dependencies=[require_role(Role.VIEWER)])
async def list_grasps(
    request: Request, tool_service: ToolServiceDep, response: Response, query: Annotated[GraspQuery, Query()]
) -> list[GraspEnded]:
    """List the grasps of all runs, newest first by default."""
    found = await tool_service.index_writer.query(tool_service.index_writer.store.find_grasps, query)
    return _return_page(request, response, query, found)


@router.get("/alarms/history", dependencies=[require_role(Role.VIEWER)])
async def list_alarm_history(
    request: Request, tool_service: ToolServiceDep, response: Response, query: Annotated[AlarmQuery, Query()]
) -> list[Alarm]:
    """List present and past alarms, each in its last state, newest first by default."""
    found = await tool_service.index_writer.query(tool_service.index_writer.store.find_alarms, query)
    return _return_page(request, response, query, found)


@router.get("/audit", dependencies=[require_role(Role.VIEWER)])
async def list_journal_history(
    request: Request, tool_service: ToolServiceDep, response: Response, query: Annotated[AuditQuery, Query()]
) -> list[JournalEntry]:
    """List the lines of the journal, newest first by default: what happened and who did it."""
    found = await tool_service.index_writer.query(tool_service.index_writer.store.find_audit_entries, query)
    return _return_page(request, response, query, found)


@router.get("/files", dependencies=[require_role(Role.VIEWER)])
async def list_recording_files(
    request: Request, tool_service: ToolServiceDep, response: Response, query: Annotated[FileQuery, Query()]
) -> list[FileRecord]:
    """List the recordings of runs, newest first by default; deleted ones say who deleted them."""
    found = await tool_service.index_writer.query(tool_service.index_writer.store.find_files, query)
    return _return_page(request, response, query, found)


def _return_page(request: Request, response: Response, query: PageQuery, page: Page[T]) -> list[T]:
    set_paging_headers(request, response, query.limit, query.offset, page.total)
    return page.items
