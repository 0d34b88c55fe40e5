"""The WebSocket of the live stream."""

from fastapi import APIRouter, WebSocket

from app.api.dependencies import ToolServiceDep
from app.messages.people import Role
from app.people.authorization import require_role

router = APIRouter()


@router.websocket("/api/live", dependencies=[require_role(Role.VIEWER)])
async def live(socket: WebSocket, tool_service: ToolServiceDep) -> None:
    """Send a `Hello`, the last seconds of samples, then everything as it happens; see app/messages/live.py."""
    await socket.accept()
    if len(tool_service.viewer_hub.viewers) >= tool_service.plan.settings.server.max_viewers:
        await socket.close(1013, "too many viewers; try again later")
        return
    messages, history = tool_service.initial_messages()
    await tool_service.viewer_hub.serve_viewer(socket, messages, history)
