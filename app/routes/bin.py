"""The bin: which deleted recordings there are still, bringing one back, removing all for good."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Query, Request

from app.people.roles import needs, signed_by
from app.problems import PROBLEM, ProblemError
from app.recording_bin import RecordingBin
from app.wire import BinContent, Emptied, FileRecord, Person, Role
from config.errors import RefusedError

router = APIRouter(prefix="/api/bin", tags=["recordings"])
By = Annotated[Person | None, Query(description="Who does it; whoever is signed in may leave it out")]
NOT_ADMIN = {403: {"description": "Not an admin", **PROBLEM}}


@router.get("", dependencies=[needs(Role.VIEWER)], responses={503: {"description": "No index", **PROBLEM}})
async def content(request: Request) -> BinContent:
    """Deleted recordings that can be restored. They take room until the bin is emptied."""
    return await _bin(request).content()


@router.post(
    "/{entry}/restore",
    dependencies=[needs(Role.ADMIN)],
    responses=NOT_ADMIN
    | {
        404: {"description": "No such entry", **PROBLEM},
        409: {"description": "There is a recording of its name", **PROBLEM},
        503: {"description": "It cannot be restored", **PROBLEM},
    },
)
async def restore(request: Request, entry: str, by: By = None) -> FileRecord:
    """Bring a deleted recording back: only an admin may. The journal keeps who did it."""
    by = signed_by(request, by)
    try:
        file = await _bin(request).find(entry)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None
    return await _bin(request).restore(file, by)


@router.delete(
    "",
    dependencies=[needs(Role.ADMIN)],
    responses=NOT_ADMIN | {503: {"description": "It cannot be emptied, or not be written down", **PROBLEM}},
)
async def empty(request: Request, by: By = None) -> Emptied:
    """Remove all that is in the bin, for good: only an admin may. The journal keeps what and who did it."""
    return await _bin(request).empty(signed_by(request, by))


def _bin(request: Request) -> RecordingBin:
    return request.app.state.bin
