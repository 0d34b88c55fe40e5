"""Routes for what people say of runs: the ground truth of grasps, and marks on the recording."""

from http import HTTPStatus
from typing import Annotated, Any

from fastapi import APIRouter, Body, Query, Request

from app.api.dependencies import ToolServiceDep
from app.api.routes.configuration import RequesterQuery
from app.api.routes.runs import RUN_NOT_FOUND_RESPONSE, check_has_tool, list_run_grasps
from app.http.audit_middleware import note_request
from app.http.problems import INVALID_RESPONSE, PROBLEM_RESPONSE, ProblemError
from app.messages.annotations import (
    GraspTruth,
    Mark,
    MarkChange,
    MarkRequest,
    TruthCorrection,
    TruthRequest,
    TruthStatement,
)
from app.messages.people import Role
from app.people.authorization import requester_name, require_role
from config.errors import ConfigurationError

router = APIRouter(prefix="/api", tags=["annotations"])
CHANGED_RESPONSE: dict[int | str, dict[str, Any]] = {
    409: {"description": "Somebody has changed it meanwhile", **PROBLEM_RESPONSE}
}
MARK_NOT_FOUND_RESPONSE: dict[int | str, dict[str, Any]] = {404: {"description": "No such mark", **PROBLEM_RESPONSE}}


@router.post(
    "/truth",
    dependencies=[require_role(Role.OPERATOR)],
    responses={409: {"description": "There is no tool", **PROBLEM_RESPONSE}},
)
async def state_truth(
    request: Request, tool_service: ToolServiceDep, body: Annotated[TruthRequest, Body()]
) -> TruthStatement:
    """State what the jaws hold, for the grasp under way or the next one. The estimator never receives it.

    `held` counts for further grasps until the next statement, a new spot or the end of the run.
    """
    note_request(request, description=f"State that the jaws hold {body.held or body.remark or 'something unknown'}")
    check_has_tool(tool_service)
    by = requester_name(request, body.by)
    tool_service.annotations.state_truth(TruthStatement(held=body.held, remark=body.remark, place=body.place, by=by))
    tool_service.state.publish()
    return tool_service.annotations.statement


@router.get("/runs/{run_id}/truth", dependencies=[require_role(Role.VIEWER)])
async def list_run_truths(tool_service: ToolServiceDep, run_id: str) -> list[GraspTruth]:
    """List the stated ground truth of a run's grasps, in order, each in its newest version; none of an unknown run."""
    return await tool_service.annotations.list_truths(run_id)


@router.put(
    "/runs/{run_id}/grasps/{grasp}/truth",
    dependencies=[require_role(Role.OPERATOR)],
    responses=RUN_NOT_FOUND_RESPONSE | CHANGED_RESPONSE | INVALID_RESPONSE,
)
async def correct_truth(
    request: Request, tool_service: ToolServiceDep, run_id: str, grasp: int, body: Annotated[TruthCorrection, Body()]
) -> GraspTruth:
    """State or correct the ground truth of a finished grasp. The journal keeps all versions, with the reason."""
    note_request(request, description=f"Correct the truth of grasp {grasp} of run {run_id}")
    if all(each.index != grasp for each in await list_run_grasps(tool_service, run_id)):
        raise ProblemError(HTTPStatus.NOT_FOUND, f"Run {run_id} has no grasp {grasp}. See the list of its grasps.")
    by = requester_name(request, body.by)
    try:
        return await tool_service.annotations.correct(run_id, grasp, body, by)
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "why") from None


@router.post(
    "/marks",
    dependencies=[require_role(Role.OPERATOR)],
    status_code=HTTPStatus.CREATED,
    responses={409: {"description": "No run is under way", **PROBLEM_RESPONSE}} | INVALID_RESPONSE,
)
async def add_mark(request: Request, tool_service: ToolServiceDep, body: Annotated[MarkRequest, Body()]) -> Mark:
    """Set a mark on the running recording, at the sample `tick` or at the newest one."""
    note_request(request, description="Set a mark")
    check_has_tool(tool_service)
    try:
        return tool_service.annotations.add_mark(body, requester_name(request, body.by))
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "tick") from None


@router.get("/runs/{run_id}/marks", dependencies=[require_role(Role.VIEWER)])
async def list_run_marks(tool_service: ToolServiceDep, run_id: str) -> list[Mark]:
    """List the marks of a run by their time; none of an unknown run."""
    return await tool_service.annotations.list_marks(run_id)


@router.put(
    "/marks/{mark_id}", dependencies=[require_role(Role.OPERATOR)], responses=MARK_NOT_FOUND_RESPONSE | CHANGED_RESPONSE
)
async def change_mark(
    request: Request, tool_service: ToolServiceDep, mark_id: str, body: Annotated[MarkChange, Body()]
) -> Mark:
    """Change the text of a mark."""
    note_request(request, description=f"Change mark {mark_id}")
    by = requester_name(request, body.by)
    return _require_mark(await tool_service.annotations.change_mark(mark_id, body.version, body.text, by), mark_id)


@router.delete(
    "/marks/{mark_id}", dependencies=[require_role(Role.OPERATOR)], responses=MARK_NOT_FOUND_RESPONSE | CHANGED_RESPONSE
)
async def delete_mark(
    request: Request,
    tool_service: ToolServiceDep,
    mark_id: str,
    version: Annotated[int, Query(ge=1, description="Version that is deleted")],
    by: RequesterQuery = None,
) -> Mark:
    """Delete a mark. The journal keeps it."""
    note_request(request, description=f"Delete mark {mark_id}")
    deleted = await tool_service.annotations.change_mark(mark_id, version, None, requester_name(request, by))
    return _require_mark(deleted, mark_id)


def _require_mark(mark: Mark | None, mark_id: str) -> Mark:
    if mark is None:
        raise ProblemError(HTTPStatus.NOT_FOUND, f"There is no mark {mark_id!r}. See the list of its run's marks.")
    return mark
