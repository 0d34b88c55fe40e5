"""Routes to list the bin, restore a recording from it, and empty it."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Query, Request

from app.api.recording_bin import RecordingBin
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.messages.wire import BinContent, Emptied, FileRecord, PersonName, Role
from app.people.authorization import require_requester_name, require_role
from config.errors import RefusedError

router = APIRouter(prefix="/api/bin", tags=["recordings"])
RequesterQuery = Annotated[
    PersonName | None, Query(description="Name of the requester; a signed-in user may leave it out")
]
FORBIDDEN_RESPONSE = {403: {"description": "Not an admin", **PROBLEM_RESPONSE}}


@router.get(
    "", dependencies=[require_role(Role.VIEWER)], responses={503: {"description": "No index", **PROBLEM_RESPONSE}}
)
async def content(request: Request) -> BinContent:
    """List deleted recordings that can be restored. They take disk space until they expire or the bin is emptied."""
    return await _get_recording_bin(request).list_content()


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
async def restore(request: Request, entry: str, by: RequesterQuery = None) -> FileRecord:
    """Restore a deleted recording; only an admin may. The journal records who did it."""
    by = require_requester_name(request, by)
    try:
        file = await _get_recording_bin(request).find(entry)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None
    return await _get_recording_bin(request).restore(file, by)


@router.delete(
    "",
    dependencies=[require_role(Role.ADMIN)],
    responses=FORBIDDEN_RESPONSE
    | {503: {"description": "It cannot be emptied, or not be written down", **PROBLEM_RESPONSE}},
)
async def empty(request: Request, by: RequesterQuery = None) -> Emptied:
    """Remove all recordings in the bin permanently; only an admin may. The journal records which, and who did it."""
    return await _get_recording_bin(request).empty(require_requester_name(request, by))


def _get_recording_bin(request: Request) -> RecordingBin:
    return request.app.state.bin
