"""The route of the live stream's WebSocket."""

from typing import Annotated

from fastapi import APIRouter, Query, WebSocket

from app.api.dependencies import ToolServiceDep
from app.messages.people import Role
from app.people.authorization import require_role

router = APIRouter()


@router.websocket("/api/live", dependencies=[require_role(Role.VIEWER)])
async def live(
    socket: WebSocket,
    tool_service: ToolServiceDep,
    after: Annotated[int | None, Query(description="Number of the last event that the viewer has received")] = None,
) -> None:
    """Send a `Hello`, the last seconds of samples, then everything as it happens; with `after`, no event is missed."""
    await socket.accept()
    if len(tool_service.viewer_hub.viewers) >= tool_service.plan.settings.server.max_viewers:
        await socket.close(1013, "too many viewers; try again later")
        return
    messages, history = tool_service.initial_messages(after)
    await tool_service.viewer_hub.serve_viewer(socket, messages, history)
