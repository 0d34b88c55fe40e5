"""Routes for laboratory sessions: who is examined, by whom, and under which conditions."""

from http import HTTPStatus
from typing import Annotated, Any

from fastapi import APIRouter, Body, Query, Request, Response

from app.api.dependencies import ToolServiceDep
from app.api.routes.configuration import RequesterQuery
from app.api.routes.runs import check_has_tool
from app.http.audit_middleware import note_request
from app.http.pagination import set_paging_headers
from app.http.problems import INVALID_RESPONSE, PROBLEM_RESPONSE, ProblemError
from app.index.queries import LabSessionQuery
from app.messages.lab_sessions import LabSession, LabSessionChange, LabSessionRequest
from app.messages.people import Role
from app.people.authorization import requester_name, require_role
from config.errors import ConfigurationError

router = APIRouter(prefix="/api/lab-sessions", tags=["lab-sessions"])
NOT_FOUND_RESPONSE: dict[int | str, dict[str, Any]] = {404: {"description": "No such session", **PROBLEM_RESPONSE}}
NO_TOOL_RESPONSE: dict[int | str, dict[str, Any]] = {409: {"description": "There is no tool", **PROBLEM_RESPONSE}}


@router.get("", dependencies=[require_role(Role.VIEWER)])
async def list_lab_sessions(
    request: Request, tool_service: ToolServiceDep, response: Response, query: Annotated[LabSessionQuery, Query()]
) -> list[LabSession]:
    """List laboratory sessions, newest first by default."""
    writer = tool_service.index_writer
    found = await writer.query(writer.store.find_lab_sessions, query)
    set_paging_headers(request, response, query.limit, query.offset, found.total)
    return found.items


@router.post(
    "",
    dependencies=[require_role(Role.OPERATOR)],
    status_code=HTTPStatus.CREATED,
    responses=INVALID_RESPONSE | NO_TOOL_RESPONSE,
)
async def begin_lab_session(
    request: Request, tool_service: ToolServiceDep, body: Annotated[LabSessionRequest, Body()]
) -> LabSession:
    """Begin a laboratory session, to which all runs belong from now on. The one before ends."""
    note_request(request, description="Begin a laboratory session")
    check_has_tool(tool_service)
    try:
        begun = tool_service.lab_sessions.begin(body, requester_name(request, body.by))
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "subject") from None
    tool_service.state.publish()
    return begun


@router.put(
    "/{session_id}",
    dependencies=[require_role(Role.OPERATOR)],
    responses=NOT_FOUND_RESPONSE
    | INVALID_RESPONSE
    | {409: {"description": "Somebody has changed it meanwhile", **PROBLEM_RESPONSE}},
)
async def change_lab_session(
    request: Request, tool_service: ToolServiceDep, session_id: str, body: Annotated[LabSessionChange, Body()]
) -> LabSession:
    """Change what a laboratory session says. The journal keeps every version."""
    note_request(request, description=f"Change laboratory session {session_id}")
    try:
        changed = await tool_service.lab_sessions.change(session_id, body, requester_name(request, body.by))
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "subject") from None
    if changed is None:
        raise ProblemError(HTTPStatus.NOT_FOUND, f"There is no session {session_id!r}. See the list of sessions.")
    tool_service.state.publish()
    return changed


@router.delete("/current", dependencies=[require_role(Role.OPERATOR)], responses=NOT_FOUND_RESPONSE | NO_TOOL_RESPONSE)
async def end_lab_session(request: Request, tool_service: ToolServiceDep, by: RequesterQuery = None) -> LabSession:
    """End the laboratory session under way. A run under way still belongs to it."""
    note_request(request, description="End the laboratory session")
    check_has_tool(tool_service)
    ended = tool_service.lab_sessions.end(requester_name(request, by))
    if ended is None:
        raise ProblemError(HTTPStatus.NOT_FOUND, "No laboratory session is under way.")
    tool_service.state.publish()
    return ended
