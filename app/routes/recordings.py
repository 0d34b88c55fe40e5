"""Recordings: the list, the files, and replays."""

from http import HTTPStatus
from pathlib import Path

from fastapi import APIRouter, Request, Response, WebSocket
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse

from app.live import Viewer
from app.problems import PROBLEM, ProblemError
from app.replay.films import Films
from app.replay.player import Replay, refuse
from app.replay.shelf import Shelf
from app.report.reports import Reports
from app.routes.studies import REPORT_POLICY
from app.station import Station
from app.wire import Recordings, ReportProgress
from config.errors import GraspwatchError, RecordingError, RefusedError

router = APIRouter(prefix="/api/recordings", tags=["recordings"])
WAITING = Path(__file__).parents[1] / "report" / "waiting.html"
WAITING_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src 'self'"
)


@router.get("")
async def recordings(request: Request) -> Recordings:
    """What can be replayed. Durations are null until the file has been read: ask again in a second."""
    shelf: Shelf = request.app.state.shelf
    return await shelf.listing()


@router.get(
    "/{name}/file",
    response_class=FileResponse,
    responses={404: {"description": "No such recording", **PROBLEM}},
)
async def file(request: Request, name: str) -> FileResponse:
    """The recording as it is on the disk."""
    path = await _path(request, name)
    return FileResponse(path, media_type="application/octet-stream", filename=name)


async def _path(request: Request, name: str) -> Path:
    shelf: Shelf = request.app.state.shelf
    try:
        return await shelf.path(name)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None


@router.get(
    "/{name}/report",
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
    try:
        made = await reports.ask(path)
    except RecordingError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error)) from None
    except RefusedError as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None
    fresh = {"Cache-Control": "no-store", "Vary": "Accept"}
    if isinstance(made, Path):
        policy = {"Content-Security-Policy": REPORT_POLICY}
        return FileResponse(made, media_type="text/html", headers=fresh | policy)
    if "text/html" in request.headers.get("accept", ""):
        policy = {"Content-Security-Policy": WAITING_POLICY}
        return HTMLResponse(WAITING.read_text(encoding="utf-8"), HTTPStatus.ACCEPTED, fresh | policy)
    return JSONResponse(ReportProgress(done=made).model_dump(), HTTPStatus.ACCEPTED, fresh)


@router.websocket("/{name}/replay")
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
