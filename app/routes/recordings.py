"""Recordings: the list, the files, and replays."""

from http import HTTPStatus

from fastapi import APIRouter, Request, WebSocket
from fastapi.responses import FileResponse

from app.live import Viewer
from app.problems import PROBLEM, ProblemError
from app.replay.films import Films
from app.replay.player import Replay, refuse
from app.replay.shelf import Shelf
from app.station import Station
from app.wire import Recordings
from config.errors import GraspwatchError, RefusedError

router = APIRouter(prefix="/api/recordings", tags=["recordings"])


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
    shelf: Shelf = request.app.state.shelf
    try:
        path = await shelf.path(name)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None
    return FileResponse(path, media_type="application/octet-stream", filename=name)


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
