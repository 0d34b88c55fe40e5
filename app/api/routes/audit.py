"""Whether the journal is as it was written, and its lines for others."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import StreamingResponse
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from app.api.routes.runs import get_tool_service
from app.audit.journal_export import JournalFilter, JournalFormat, export_lines
from app.http.problems import PROBLEM_RESPONSE
from app.index.queries import SearchText
from app.messages.wire import JournalCheck, Role
from app.people.authorization import require_role
from app.service.journal_watch import JournalWatch

router = APIRouter(prefix="/api/audit", tags=["history"])
MEDIA_TYPES = {JournalFormat.CSV: "text/csv", JournalFormat.JSONL: "application/jsonl"}


class ExportQuery(BaseModel):
    """Null: any."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: JournalFormat = JournalFormat.CSV
    since: Annotated[AwareDatetime | None, Field(description="ISO 8601 with a zone; from then on")] = None
    until: Annotated[AwareDatetime | None, Field(description="ISO 8601 with a zone; before then")] = None
    by: SearchText | None = None


@router.get(
    "/check",
    dependencies=[require_role(Role.VIEWER)],
    responses={503: {"description": "The index cannot be asked", **PROBLEM_RESPONSE}},
)
async def check(request: Request) -> JournalCheck:
    """Whether any line was changed, removed, put in or moved: by the chain, and by what the index knows.

    `graspwatch audit verify` also asks the recordings. What was found is told again for five seconds.
    """
    chain: JournalWatch = request.app.state.chain
    return await chain.check()


@router.get("/export", dependencies=[require_role(Role.ADMIN)], response_class=StreamingResponse)
async def export_journal(request: Request, query: Annotated[ExportQuery, Query()]) -> StreamingResponse:
    """The journal, oldest line first: a table, or the lines as they stand."""
    lines = export_lines(
        get_tool_service(request).plan.data_folder, JournalFilter(query.since, query.until, query.by), query.format
    )
    headers = {"Content-Disposition": f'attachment; filename="graspwatch-journal.{query.format.value}"'}
    return StreamingResponse(lines, media_type=MEDIA_TYPES[query.format], headers=headers)
