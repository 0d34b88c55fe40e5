"""The classes Viewer, with queues of its own so that it delays no other, and ViewerHub, for all of the live stream."""

import asyncio
from collections import deque
from collections.abc import Callable

from fastapi import WebSocket, WebSocketDisconnect
from pydantic import BaseModel, TypeAdapter, ValidationError

from app.host.clock import now_ms
from app.messages.live import FRAME_HEADER, FrameReceived, ReplayControl, StreamEvent

MAX_QUEUED_MESSAGES = 2_000  # messages are never dropped: a viewer with more unread is disconnected
MAX_KEPT_EVENTS = 1_000  # that a viewer can catch up on after it was disconnected
SEQUENCE_FIELD_INDEX = 5  # of FRAME_HEADER
MAX_QUEUED_FRAMES = 30  # a second of frames; the oldest are dropped first
LIVE_VIEWER_MESSAGE: TypeAdapter[FrameReceived] = TypeAdapter(FrameReceived)
REPLAY_VIEWER_MESSAGE: TypeAdapter[FrameReceived | ReplayControl] = TypeAdapter(FrameReceived | ReplayControl)


class Viewer:
    """One connection. Messages wait in order; sample frames wait in a short queue that drops its oldest.

    With `on_control` it is a replay's viewer: it may send controls, and no frame is dropped.
    """

    def __init__(
        self, socket: WebSocket, window_frames: int, on_control: Callable[[ReplayControl], None] | None = None
    ) -> None:
        self._socket = socket
        self._window_frames = window_frames
        self._on_control = on_control
        self._messages: deque[str] = deque()
        self._frames: deque[bytes] = deque(maxlen=None if on_control else MAX_QUEUED_FRAMES)
        self._unacknowledged_frames: deque[int] = deque()
        self._wake_up = asyncio.Event()
        self._close_request: tuple[int, str] | None = None
        self.has_overrun = False

    @property
    def has_sent_all_messages(self) -> bool:
        return not self._messages

    @property
    def has_sent_everything(self) -> bool:
        return not self._messages and not self._frames

    def send(self, message: str) -> None:
        if len(self._messages) >= MAX_QUEUED_MESSAGES and not self._on_control:
            self.has_overrun = True
        else:
            self._messages.append(message)
        self._wake_up.set()

    def send_frame(self, frame: bytes) -> None:
        self._frames.append(frame)
        self._wake_up.set()

    def drop_frames(self) -> None:
        """Drop the waiting frames, which are out of date."""
        self._frames.clear()

    def close(self, code: int, reason: str) -> None:
        """Close the connection after the waiting messages. The first call counts; a reason has up to 123 bytes."""
        self._close_request = self._close_request or (code, reason)
        self._wake_up.set()

    async def serve(self) -> None:
        """Send and receive until the viewer leaves or is too slow."""
        tasks = [asyncio.create_task(self._receive()), asyncio.create_task(self._transmit())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        except (WebSocketDisconnect, RuntimeError):  # RuntimeError: sent after the close was received
            return
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _transmit(self) -> None:
        while not self.has_overrun:
            await self._wake_up.wait()
            self._wake_up.clear()
            while self._messages and not self.has_overrun:
                await self._socket.send_text(self._messages.popleft())
            if self._close_request:
                await self._socket.close(*self._close_request)
                return
            while self._frames and len(self._unacknowledged_frames) < self._window_frames and not self._messages:
                frame = self._frames.popleft()
                self._unacknowledged_frames.append(FRAME_HEADER.unpack_from(frame)[SEQUENCE_FIELD_INDEX])
                await self._socket.send_bytes(frame)

    async def _receive(self) -> None:
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            try:
                received = (REPLAY_VIEWER_MESSAGE if self._on_control else LIVE_VIEWER_MESSAGE).validate_json(
                    message.get("text") or ""
                )
            except ValidationError:
                await self._socket.close(1007, "expected {'type': 'received', 'sequence': n}")
                return
            if isinstance(received, ReplayControl):
                assert self._on_control is not None
                self._on_control(received)
                continue
            while self._unacknowledged_frames and self._unacknowledged_frames[0] <= received.sequence:
                self._unacknowledged_frames.popleft()
            self._wake_up.set()


class ViewerHub:
    """Hub of the live stream: sends messages to all viewers, and numbers and keeps the newest events.

    Events are log lines, changes of alarms, ended grasps, and what people say of them.

    Events are numbered. The numbers of a service begin at the time of its start in milliseconds, so they are greater
    than all numbers of an earlier service.
    """

    def __init__(self, window_frames: int) -> None:
        self._window_frames = window_frames
        self.viewers: set[Viewer] = set()
        self.newest_event_number = int(now_ms())
        self._events: deque[StreamEvent] = deque(maxlen=MAX_KEPT_EVENTS)

    def broadcast(self, message: BaseModel) -> None:
        """Send a message to all viewers; number it and keep it if it is an event."""
        if isinstance(message, StreamEvent):
            self.newest_event_number += 1
            message = message.model_copy(update={"number": self.newest_event_number})
            self._events.append(message)
        text = message.model_dump_json()
        for viewer in self.viewers:
            viewer.send(text)

    def list_events_after(self, number: int) -> list[StreamEvent] | None:
        """Return the events numbered after `number`; None if not all of them are kept, or there was no such event."""
        missed = self.newest_event_number - number
        return list(self._events)[len(self._events) - missed :] if 0 <= missed <= len(self._events) else None

    def broadcast_frame(self, frame: bytes) -> None:
        for viewer in self.viewers:
            viewer.send_frame(frame)

    async def serve_viewer(self, socket: WebSocket, initial_messages: list[BaseModel], history: list[bytes]) -> None:
        """Serve one viewer until it leaves: initial messages and history first, then the live stream."""
        viewer = Viewer(socket, self._window_frames)
        for message in initial_messages:
            viewer.send(message.model_dump_json())
        for frame in history:
            viewer.send_frame(frame)
        self.viewers.add(viewer)
        try:
            await viewer.serve()
        finally:
            self.viewers.discard(viewer)
