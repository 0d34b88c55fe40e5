"""The live stream."""

from fastapi import APIRouter, WebSocket

from app.people.roles import needs
from app.station import Station
from app.wire import Role

router = APIRouter()


@router.websocket("/api/live", dependencies=[needs(Role.VIEWER)])
async def live(socket: WebSocket) -> None:
    """Hello, the last seconds, then everything as it happens; see app/wire.py."""
    station: Station = socket.app.state.station
    await socket.accept()
    if len(station.hub.viewers) >= station.plan.settings.server.max_viewers:
        await socket.close(1013, "too many viewers; try again later")
        return
    messages, history = station.greeting()
    await station.hub.attend(socket, messages, history)
