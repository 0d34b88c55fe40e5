"""Recordings: the list, the files, and replays."""

from datetime import datetime
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response, WebSocket
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse

from app.audit.deeds import client_of
from app.live import Viewer
from app.people.roles import needs, signed_by
from app.problems import PROBLEM, ProblemError
from app.recording_bin import RecordingBin
from app.replay.films import Films
from app.replay.player import Replay, refuse
from app.replay.shelf import Shelf
from app.report.reports import Reports
from app.routes.paging import tell_page
from app.routes.studies import REPORT_POLICY
from app.station import Station
from app.store.questions import RecordingQuestion
from app.wire import Person, RecordingInfo, Recordings, ReportProgress, Result, Role
from config.errors import GraspwatchError, RecordingError, RefusedError

router = APIRouter(prefix="/api/recordings", tags=["recordings"])
WAITING = Path(__file__).parents[1] / "report" / "waiting.html"
WAITING_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src 'self'"
)


@router.get("", dependencies=[needs(Role.VIEWER)])
async def recordings(request: Request, response: Response, asked: Annotated[RecordingQuestion, Query()]) -> Recordings:
    """What can be replayed. Durations are null until the file has been read: ask again in a second."""
    shelf: Shelf = request.app.state.shelf
    listing = await shelf.listing()
    found = [recording for recording in listing.recordings if _fits(recording, asked)]
    limit = asked.limit or max(len(found), 1)
    tell_page(request, response, limit, asked.offset, len(found))
    return listing.model_copy(update={"recordings": found[asked.offset : asked.offset + limit]})


def _fits(recording: RecordingInfo, asked: RecordingQuestion) -> bool:
    modified = datetime.fromisoformat(recording.modified_at)
    return (
        (asked.q is None or asked.q.casefold() in recording.name.casefold())
        and (asked.since is None or modified >= asked.since)
        and (asked.until is None or modified < asked.until)
    )


@router.get(
    "/{name}/file",
    dependencies=[needs(Role.VIEWER)],
    response_class=FileResponse,
    responses={
        206: {"description": "The part that `Range` asked for"},
        404: {"description": "No such recording", **PROBLEM},
        416: {"description": "There is no such part"},
    },
)
async def file(request: Request, name: str) -> FileResponse:
    """The recording as it is on the disk, or a part of it (`Range`, `If-Range`)."""
    return FileResponse(await _path(request, name), media_type="application/octet-stream", filename=name)


async def _path(request: Request, name: str) -> Path:
    shelf: Shelf = request.app.state.shelf
    try:
        return await shelf.path(name)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None


@router.delete(
    "/{name}",
    dependencies=[needs(Role.ADMIN)],
    status_code=HTTPStatus.NO_CONTENT,
    responses={
        403: {"description": "Not an admin", **PROBLEM},
        404: {"description": "No such recording", **PROBLEM},
        409: {"description": "In use", **PROBLEM},
        503: {"description": "It cannot be deleted, or not be written down", **PROBLEM},
    },
)
async def delete(
    request: Request,
    name: str,
    by: Annotated[Person | None, Query(description="Who deletes it; whoever is signed in may leave it out")] = None,
) -> None:
    """Delete a recording: only an admin may. It lies in the bin for a while, from where it can be restored; the journal
    and the index keep who did it."""
    by = signed_by(request, by)
    path = await _path(request, name)
    _refuse_in_use(request, path)
    bin_: RecordingBin = request.app.state.bin
    await bin_.delete(path, by)


def _refuse_in_use(request: Request, path: Path) -> None:
    station: Station = request.app.state.station
    shelf: Shelf = request.app.state.shelf
    films: Films = request.app.state.films
    if Path(station.recorder.state.file or "").name == path.name:
        why = "it is being recorded. Stop the run first."
    elif shelf.is_opened(path):
        why = "it was opened on the command line. End that service first."
    elif films.watched(path):
        why = "somebody is watching it. Close its replay first."
    else:
        return
    raise ProblemError(HTTPStatus.CONFLICT, f"{path.name} is in use: {why}")


@router.get(
    "/{name}/report",
    dependencies=[needs(Role.VIEWER)],
    response_class=HTMLResponse,
    responses={
        200: {"description": "The page, self-contained"},
        202: {"description": "It is being made: how far it is, or a page that waits for it", "model": ReportProgress},
        404: {"description": "No such recording", **PROBLEM},
        422: {"description": "The recording cannot be read", **PROBLEM},
        503: {"description": "Too many reports are being made", **PROBLEM},
    },
)
async def report(request: Request, name: str) -> Response:
    """The recording's report. It is made when it is first asked for, which takes a second for half a minute of it.

    Ask again until the answer is no more 202; a browser gets a page that does so.
    """
    reports: Reports = request.app.state.reports
    path = await _path(request, name)
    station: Station = request.app.state.station
    note = partial(station.journal.deed, "report", f"Make report of {name}", client=client_of(request))
    try:
        made = await reports.ask(path, partial(note, result=Result.DONE))
    except RecordingError as error:
        note(result=Result.FAILED, reason=str(error))
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error)) from None
    except RefusedError as error:
        note(result=Result.REFUSED, reason=str(error))
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None
    fresh = {"Cache-Control": "no-store", "Vary": "Accept"}
    if isinstance(made, Path):
        policy = {"Content-Security-Policy": REPORT_POLICY}
        return FileResponse(made, media_type="text/html", headers=fresh | policy)
    if "text/html" in request.headers.get("accept", ""):
        policy = {"Content-Security-Policy": WAITING_POLICY}
        return HTMLResponse(WAITING.read_text(encoding="utf-8"), HTTPStatus.ACCEPTED, fresh | policy)
    return JSONResponse(ReportProgress(done=made).model_dump(), HTTPStatus.ACCEPTED, fresh)


@router.websocket("/{name}/replay", dependencies=[needs(Role.VIEWER)])
async def replay(socket: WebSocket, name: str) -> None:
    """The recording as it would have been seen live, with pause, seek and speed; see app/wire.py."""
    station: Station = socket.app.state.station
    films: Films = socket.app.state.films
    shelf: Shelf = socket.app.state.shelf
    server = station.plan.settings.server
    await socket.accept()
    try:
        path = await shelf.path(name)
        if films.viewers >= server.max_viewers:
            await socket.close(1013, "too many viewers; try again later")
            return
        with films.watching(path) as showing:
            await Replay(station.plan, name, showing, socket).serve()
    except GraspwatchError as error:
        viewer = Viewer(socket, server.chart_window_frames)
        refuse(viewer, error)
        await viewer.serve()
