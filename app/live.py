"""Viewers, of `/api/live` and of replays: each with its own queues, so that a slow one disturbs nobody."""

import asyncio
from collections import deque
from collections.abc import Callable

from fastapi import WebSocket, WebSocketDisconnect
from pydantic import BaseModel, TypeAdapter, ValidationError

from app.wire import FRAME_HEADER, FrameReceived, ReplayControl

MESSAGES_KEPT = 2_000  # a viewer that leaves more unread is dead: it is disconnected, messages are never dropped
SEQUENCE_FIELD = 5  # of FRAME_HEADER
FRAMES_KEPT = 30  # a second of frames; the oldest go first
OF_LIVE: TypeAdapter[FrameReceived] = TypeAdapter(FrameReceived)
OF_REPLAY: TypeAdapter[FrameReceived | ReplayControl] = TypeAdapter(FrameReceived | ReplayControl)


class Viewer:
    """One connection. Messages wait in order; sample frames wait in a short queue that drops its oldest.

    With `obey` it is a replay's, which takes the viewer's wishes and waits for it: nothing is dropped.
    """

    def __init__(
        self, socket: WebSocket, window_frames: int, obey: Callable[[ReplayControl], None] | None = None
    ) -> None:
        self._socket = socket
        self._window = window_frames
        self._obey = obey
        self._messages: deque[str] = deque()
        self._frames: deque[bytes] = deque(maxlen=None if obey else FRAMES_KEPT)
        self._unanswered: deque[int] = deque()
        self._work = asyncio.Event()
        self._farewell: tuple[int, str] | None = None
        self.overrun = False

    @property
    def reads(self) -> bool:
        """Whether it was sent all messages."""
        return not self._messages

    @property
    def follows(self) -> bool:
        """Whether it was sent everything."""
        return not self._messages and not self._frames

    def send(self, message: str) -> None:
        if len(self._messages) >= MESSAGES_KEPT and not self._obey:
            self.overrun = True
        else:
            self._messages.append(message)
        self._work.set()

    def send_frame(self, frame: bytes) -> None:
        self._frames.append(frame)
        self._work.set()

    def drop_frames(self) -> None:
        """Those that wait are out of date."""
        self._frames.clear()

    def close(self, code: int, reason: str) -> None:
        """Close the connection after the messages that wait. The first call counts; a reason has up to 123 bytes."""
        self._farewell = self._farewell or (code, reason)
        self._work.set()

    async def serve(self) -> None:
        """Send and receive until the viewer leaves, or cannot follow any more."""
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
        while not self.overrun:
            await self._work.wait()
            self._work.clear()
            while self._messages and not self.overrun:
                await self._socket.send_text(self._messages.popleft())
            if self._farewell:
                await self._socket.close(*self._farewell)
                return
            while self._frames and len(self._unanswered) < self._window and not self._messages:
                frame = self._frames.popleft()
                self._unanswered.append(FRAME_HEADER.unpack_from(frame)[SEQUENCE_FIELD])
                await self._socket.send_bytes(frame)

    async def _receive(self) -> None:
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            try:
                received = (OF_REPLAY if self._obey else OF_LIVE).validate_json(message.get("text") or "")
            except ValidationError:
                await self._socket.close(1007, "expected {'type': 'received', 'sequence': n}")
                return
            if isinstance(received, ReplayControl):
                self._obey(received)
                continue
            while self._unanswered and self._unanswered[0] <= received.sequence:
                self._unanswered.popleft()
            self._work.set()


class Hub:
    """All viewers."""

    def __init__(self, window_frames: int) -> None:
        self._window = window_frames
        self.viewers: set[Viewer] = set()

    def broadcast(self, message: BaseModel) -> None:
        text = message.model_dump_json()
        for viewer in self.viewers:
            viewer.send(text)

    def broadcast_frame(self, frame: bytes) -> None:
        for viewer in self.viewers:
            viewer.send_frame(frame)

    async def attend(self, socket: WebSocket, greeting: list[BaseModel], history: list[bytes]) -> None:
        """Serve one viewer until it leaves: first the greeting and the last seconds, then what comes."""
        viewer = Viewer(socket, self._window)
        for message in greeting:
            viewer.send(message.model_dump_json())
        for frame in history:
            viewer.send_frame(frame)
        self.viewers.add(viewer)
        try:
            await viewer.serve()
        finally:
            self.viewers.discard(viewer)
