"""Routes that read all recordings of the data folder: one table of their grasps, and their evaluation."""

import asyncio
from collections.abc import Callable, Sequence
from http import HTTPStatus
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import HTMLResponse

from acquisition.recordings.file_names import list_run_files
from app.analysis.evaluation_page import send_evaluation_page
from app.analysis.grasp_collection import Corrections, EstimationContext, send_grasp_table
from app.api.dependencies import ToolServiceDep
from app.api.routes.studies import REPORT_POLICY
from app.host.background_process import run_in_background_process
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.messages.people import Role
from app.people.authorization import require_role
from app.service.tool_service import ToolService
from config.errors import ConfigurationError
from config.load import FileKind, list_names, load_library, require_known_name

router = APIRouter(prefix="/api", tags=["history"], responses={503: {"description": "No index", **PROBLEM_RESPONSE}})
TABLE_TYPES = {"parquet": "application/vnd.apache.parquet", "csv": "text/csv"}
_reading_lock = asyncio.Lock()


@router.get(
    "/grasps.{suffix}",
    dependencies=[require_role(Role.VIEWER)],
    response_class=Response,
    responses={
        200: {
            "description": "The table, as a file",
            "content": {
                media_type: {"schema": {"type": "string", "format": "binary"}} for media_type in TABLE_TYPES.values()
            },
            "headers": {"X-Left-Out": {"description": "Recordings that cannot be read", "schema": {"type": "integer"}}},
        },
        409: {"description": "Another table is being made", **PROBLEM_RESPONSE},
    },
)
async def download_grasp_table(
    request: Request, tool_service: ToolServiceDep, suffix: Literal["parquet", "csv"]
) -> Response:
    """Return one table of the grasps of all recordings in the data folder: a row a grasp, as recorded.

    It has the columns of `graspwatch grasps`, with the truths and sessions as they are now. Demonstrations are left
    out, and so are recordings that cannot be read: `X-Left-Out` counts these. 30 recordings take about a second.
    """
    headers = {"Content-Disposition": f'attachment; filename="grasps.{suffix}"'}
    if request.method == "HEAD":  # builds nothing
        return Response(media_type=TABLE_TYPES[suffix], headers=headers)
    content, left_out = await _build_from_recordings(
        tool_service, send_grasp_table, _as_recorded(tool_service), f".{suffix}"
    )
    return Response(content, media_type=TABLE_TYPES[suffix], headers=headers | {"X-Left-Out": str(left_out)})


@router.get(
    "/evaluation",
    dependencies=[require_role(Role.VIEWER)],
    response_class=HTMLResponse,
    responses={
        200: {"description": "The page, self-contained"},
        409: {"description": "No grasp can be judged, or another table is being made", **PROBLEM_RESPONSE},
    },
)
async def evaluate_answers(
    request: Request,
    tool_service: ToolServiceDep,
    library: Annotated[
        Sequence[str], Query(max_length=3, description="Estimate all anew with these libraries, side by side")
    ] = (),
) -> HTMLResponse:
    """Return a page that compares the answers of all recordings with what was held, as `graspwatch evaluate`.

    Without `library` the answers are those that the recordings were made with.
    """
    if request.method == "HEAD":  # builds nothing
        return HTMLResponse()
    plan = tool_service.plan
    try:
        known = list_names(FileKind.LIBRARY, plan.data_folder)  # never a path
        libraries = [load_library(require_known_name(name, known, "library"), plan.data_folder) for name in library]
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "library") from None
    contexts = {each.name: EstimationContext(plan.recording_tool, plan.settings, each, each) for each in libraries}
    page = await _build_from_recordings(
        tool_service, send_evaluation_page, contexts or {"as recorded": _as_recorded(tool_service)}
    )
    return HTMLResponse(page, headers={"Content-Security-Policy": REPORT_POLICY})


def _as_recorded(tool_service: ToolService) -> EstimationContext:
    plan = tool_service.plan
    return EstimationContext(plan.recording_tool, plan.settings, None, plan.library)


async def _build_from_recordings(tool_service: ToolService, build: Callable[..., None], *wanted: Any) -> Any:
    """Return what `build` sends of all recordings; one at a time, because each process takes time from a live tool.

    Raises:
        ProblemError: another one is under way, or there is nothing to build from.
    """
    if _reading_lock.locked():
        raise ProblemError(HTTPStatus.CONFLICT, "Another table of grasps is being made. Try again in a moment.")
    writer = tool_service.index_writer
    async with _reading_lock:
        corrections = await writer.query(Corrections.from_index, writer.store)
        paths = await asyncio.to_thread(list_run_files, tool_service.plan.recordings_folder)
        advice = "Ask for it again, or use `graspwatch grasps` with some of the recordings."
        found: list[Any] = []
        try:
            await run_in_background_process(
                "table", build, paths, corrections, *wanted, on_message=found.append, advice=advice
            )
        except ConfigurationError as error:
            raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    return found[0]
