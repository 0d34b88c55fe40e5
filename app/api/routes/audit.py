"""Routes to verify the journal and to export its lines."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import StreamingResponse
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from app.api.dependencies import JournalWatchDep, ToolServiceDep
from app.audit.journal_export import JournalFilter, JournalFormat, export_lines
from app.http.problems import PROBLEM_RESPONSE
from app.index.queries import SearchText
from app.messages.journal import JournalCheck
from app.messages.people import Role
from app.people.authorization import require_role

router = APIRouter(prefix="/api/audit", tags=["history"])
MEDIA_TYPES = {JournalFormat.CSV: "text/csv", JournalFormat.JSONL: "application/jsonl"}


class ExportQuery(BaseModel):
    """Filter and format of an export; a null filter matches every line."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: JournalFormat = JournalFormat.CSV
    since: Annotated[AwareDatetime | None, Field(description="ISO 8601 with a time zone; lines from this time on")] = (
        None
    )
    until: Annotated[AwareDatetime | None, Field(description="ISO 8601 with a time zone; lines before this time")] = (
        None
    )
    by: SearchText | None = None


@router.get(
    "/check",
    response_model=JournalCheck,
    dependencies=[require_role(Role.VIEWER)],
    responses={503: {"description": "The index cannot be asked", **PROBLEM_RESPONSE}},
)
async def check_journal(request: Request, chain: JournalWatchDep) -> JournalCheck | StreamingResponse:
    """Check by the hash chain and the index whether any line of the journal was changed, removed, inserted or moved.

    `graspwatch audit verify` also checks the recordings. The result is cached for five seconds.
    """
    if request.method == "HEAD":
        return StreamingResponse((), media_type="application/json")  # says no length
    return await chain.check()


@router.get(
    "/export",
    dependencies=[require_role(Role.ADMIN)],
    response_class=StreamingResponse,
    responses={
        200: {
            "description": "The lines",
            "content": {each: {"schema": {"type": "string"}} for each in MEDIA_TYPES.values()},
        }
    },
)
async def export_journal(
    request: Request, tool_service: ToolServiceDep, query: Annotated[ExportQuery, Query()]
) -> StreamingResponse:
    """Return the journal, oldest line first, as CSV or as the original JSON lines."""
    lines = export_lines(tool_service.plan.data_folder, JournalFilter(query.since, query.until, query.by), query.format)
    headers = {"Content-Disposition": f'attachment; filename="graspwatch-journal.{query.format.value}"'}
    return StreamingResponse(
        () if request.method == "HEAD" else lines, media_type=MEDIA_TYPES[query.format], headers=headers
    )
