"""Whether the journal is as it was written, and its lines for others."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import StreamingResponse
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from app.audit.export import JournalFormat, Wanted, export
from app.audit.watch import ChainWatch
from app.people.roles import needs
from app.problems import PROBLEM
from app.routes.runs import station_of
from app.store.questions import Words
from app.wire import JournalCheck, Role

router = APIRouter(prefix="/api/audit", tags=["history"])
MEDIA_TYPES = {JournalFormat.CSV: "text/csv", JournalFormat.JSONL: "application/jsonl"}


class ExportQuestion(BaseModel):
    """Null: any."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: JournalFormat = JournalFormat.CSV
    since: Annotated[AwareDatetime | None, Field(description="ISO 8601 with a zone; from then on")] = None
    until: Annotated[AwareDatetime | None, Field(description="ISO 8601 with a zone; before then")] = None
    by: Words | None = None


@router.get(
    "/check",
    dependencies=[needs(Role.VIEWER)],
    responses={503: {"description": "The index cannot be asked", **PROBLEM}},
)
async def check(request: Request) -> JournalCheck:
    """Whether any line was changed, removed, put in or moved: by the chain, and by what the index knows.

    `graspwatch audit verify` also asks the recordings. What was found is told again for five seconds.
    """
    chain: ChainWatch = request.app.state.chain
    return await chain.look()


@router.get("/export", dependencies=[needs(Role.ADMIN)], response_class=StreamingResponse)
async def export_journal(request: Request, asked: Annotated[ExportQuestion, Query()]) -> StreamingResponse:
    """The journal, oldest line first: a table, or the lines as they stand."""
    lines = export(station_of(request).plan.data, Wanted(asked.since, asked.until, asked.by), asked.format)
    headers = {"Content-Disposition": f'attachment; filename="graspwatch-journal.{asked.format.value}"'}
    return StreamingResponse(lines, media_type=MEDIA_TYPES[asked.format], headers=headers)
