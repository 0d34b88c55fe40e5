"""Routes to list the bin, restore a recording from it, and empty it."""

from http import HTTPStatus
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request

from app.api.dependencies import RecordingBinDep
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.messages.base import PersonName
from app.messages.people import Role
from app.messages.recordings import BinContent, Emptied, FileRecord
from app.people.authorization import require_requester_name, require_role
from config.errors import RefusedError

router = APIRouter(prefix="/api/bin", tags=["recordings"])
RequesterQuery = Annotated[
    PersonName | None, Query(description="Name of the requester; a signed-in user may leave it out")
]
FORBIDDEN_RESPONSE: dict[int | str, dict[str, Any]] = {403: {"description": "Not an admin", **PROBLEM_RESPONSE}}


@router.get(
    "", dependencies=[require_role(Role.VIEWER)], responses={503: {"description": "No index", **PROBLEM_RESPONSE}}
)
async def list_deleted_recordings(recording_bin: RecordingBinDep) -> BinContent:
    """List deleted recordings that can be restored. They take disk space until they expire or the bin is emptied."""
    return await recording_bin.list_content()


@router.post(
    "/{entry}/restore",
    dependencies=[require_role(Role.ADMIN)],
    responses=FORBIDDEN_RESPONSE
    | {
        404: {"description": "No such entry", **PROBLEM_RESPONSE},
        409: {"description": "There is a recording of its name", **PROBLEM_RESPONSE},
        503: {"description": "It cannot be restored", **PROBLEM_RESPONSE},
    },
)
async def restore_recording(
    request: Request, recording_bin: RecordingBinDep, entry: str, by: RequesterQuery = None
) -> FileRecord:
    """Restore a deleted recording, and return its record; only an admin may. The journal records who did it."""
    by = require_requester_name(request, by)
    try:
        file = await recording_bin.find(entry)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None
    return await recording_bin.restore(file, by)


@router.delete(
    "",
    dependencies=[require_role(Role.ADMIN)],
    responses=FORBIDDEN_RESPONSE
    | {503: {"description": "It cannot be emptied, or not be written down", **PROBLEM_RESPONSE}},
)
async def empty_bin(request: Request, recording_bin: RecordingBinDep, by: RequesterQuery = None) -> Emptied:
    """Remove all recordings in the bin permanently; only an admin may. The journal records which, and who did it."""
    return await recording_bin.empty(require_requester_name(request, by))
