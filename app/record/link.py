"""The server's end of the recorder: what it tells the recorder, and what it knows of it."""

from typing import Any

import zmq
from pydantic import BaseModel

from acquisition import bus
from app.record.recorder import Brief
from app.record.topics import topic_of, write
from app.record.worker import pack_brief
from app.wire import RecordingState

NO_RECORDER = RecordingState(enabled=False, file=None, samples=0, missing_blocks=0, problem=None)


class RecorderLink:
    """Tells the recorder of runs, and of all messages that are recorded."""

    def __init__(self, address: str, *, enabled: bool) -> None:
        self._context = zmq.Context()
        self._socket = bus.publisher(self._context, address)
        self._state = NO_RECORDER.model_copy(update={"enabled": enabled})

    @property
    def state(self) -> RecordingState:
        return self._state

    def brief(self, brief: Brief) -> None:
        """A run is about to begin; tell before the tool is told."""
        self._send(pack_brief(brief))

    def tell(self, message: BaseModel) -> None:
        """A message to viewers, or a line of the journal."""
        topic = topic_of(message)
        if topic:
            self._send(bus.pack_told(topic, write(message)))

    def _send(self, parts: list[bytes]) -> None:
        self._socket.send_multipart(parts)  # PUB never waits: what a reader that hangs has no room for is dropped

    def heard(self, notice: dict[str, Any]) -> None:
        """Take how it stands with the recorder."""
        known = {name: notice[name] for name in ("file", "samples", "missing_blocks")}
        begins = known["file"] is not None and known["file"] != self._state.file
        problem = None if begins else self._state.problem
        self._state = self._state.model_copy(update=known | {"problem": problem})

    def stopped(self, text: str | None) -> None:
        """A recording ended before its run, or the recorder died; None where all is well again."""
        self._state = self._state.model_copy(update={"problem": text, "file": None, "samples": 0})

    def close(self) -> None:
        self._context.destroy(linger=200)
