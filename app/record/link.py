"""The server's end of the recorder: what it tells the recorder, and what it makes of the answers."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq
from pydantic import BaseModel

from acquisition import bus
from app.alarms import AlarmBook
from app.plan import ServicePlan
from app.record.indexing import recorded_file
from app.record.recorder import Brief
from app.record.topics import topic_of, write
from app.record.worker import pack_brief
from app.store.keeper import Index
from app.wire import FileRecord, Priority, RecordingState

NO_RECORDER = RecordingState(enabled=False, file=None, samples=0, missing_blocks=0, problem=None)


class RecorderLink:
    """Tells the recorder of runs, and of all messages that are recorded; alarms where recording fails."""

    def __init__(
        self, plan: ServicePlan, address: str, alarms: AlarmBook, index: Index, tell_event: Callable[[str], None]
    ) -> None:
        self._context = zmq.Context()
        self._socket = bus.publisher(self._context, address)
        self._folder, self._alarms, self._index, self._tell_event = plan.recordings_folder, alarms, index, tell_event
        self._reading: set[asyncio.Task[FileRecord]] = set()
        enabled = plan.settings.recording.enabled and not plan.opened
        self.state = NO_RECORDER.model_copy(update={"enabled": enabled})

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
        """What the recorder says."""
        match notice["kind"]:
            case "recording":
                self._follow({name: notice[name] for name in ("file", "samples", "missing_blocks")})
            case "recorded":
                self._put_into_index(self._folder / notice["file"])
            case "mended":
                self._tell_event(f"The recording {notice['file']} had been cut off, and was made whole")
                self._put_into_index(self._folder / notice["file"])
            case "recording_stopped":
                self._stopped(notice["text"])
                self._alarms.raise_technical("recording", Priority.MEDIUM, notice["text"])
                self._tell_event(notice["text"])

    def died(self, text: str) -> None:
        """The recorder died; the supervisor has said how."""
        self._stopped("the recorder died")
        self._alarms.raise_technical("recorder", Priority.MEDIUM, f"{text} Meanwhile nothing is recorded.")
        self._tell_event(text)

    def _follow(self, known: dict[str, Any]) -> None:
        begins = known["file"] is not None and self.state.file is None
        if begins:
            self._alarms.end("recording")
        problem = None if begins else self.state.problem
        self.state = self.state.model_copy(update=known | {"problem": problem})

    def _stopped(self, text: str) -> None:
        self.state = self.state.model_copy(update={"problem": text, "file": None, "samples": 0})

    def _put_into_index(self, path: Path) -> None:
        reading = asyncio.create_task(asyncio.to_thread(recorded_file, path))
        self._reading.add(reading)
        reading.add_done_callback(self._was_read)

    def _was_read(self, reading: "asyncio.Task[FileRecord]") -> None:
        self._reading.discard(reading)
        gone = reading.cancelled() or isinstance(reading.exception(), OSError)
        if not gone:
            self._index.take(reading.result())

    async def aclose(self) -> None:
        """After the recorder has ended: put what it recorded last into the index, and close."""
        if self.state.file:
            self._put_into_index(self._folder / self.state.file)
        await asyncio.gather(*self._reading, return_exceptions=True)
        self._context.destroy(linger=200)
