"""The class RecorderLink, which follows the recorder's notices: files written and completed, and why it stopped."""

import asyncio
from pathlib import Path

from acquisition.notices import Notice, RecorderStatus, RecordingFileClosed, RecordingRecovered, RecordingStopped
from acquisition.recordings.file_names import DEMO_ID_PREFIX
from acquisition.recordings.mcap_reader import McapFile
from app.messages.journal import JournalKind
from app.messages.live import RECORDER_OFF, RecordingState
from app.messages.recordings import CompletedFile, FileRecord
from app.recordings.index_reader import read_file_record
from app.recordings.manifest import digest_file
from app.service.publisher import Publisher
from config.errors import RecordingError
from config.service_plan import ServicePlan
from estimator.force_alarms import Priority


class RecorderLink:
    """The server's copy of the recorder's state; it raises alarms where recording fails."""

    def __init__(self, plan: ServicePlan, publisher: Publisher) -> None:
        self._recordings_folder, self._publisher, self._alarms = plan.recordings_folder, publisher, publisher.alarms
        self._file_read_tasks: set[asyncio.Task[FileRecord]] = set()
        enabled = plan.settings.recording.enabled and not plan.opened_recordings
        self.state = RECORDER_OFF.model_copy(update={"enabled": enabled})

    def on_notice(self, notice: Notice) -> None:
        match notice:
            case RecorderStatus():
                self._update_state(notice)
            case RecordingFileClosed():
                self._index_file(self._recordings_folder / notice.file)
                if notice.sha256:
                    self._write_completed(notice.file, notice.sha256)
            case RecordingRecovered():
                self._publisher.publish_event(f"The recording {notice.file} had been cut off, and was made whole")
                self._index_file(self._recordings_folder / notice.file)
                self._write_completed(notice.file, notice.sha256)
            case RecordingStopped():
                self._mark_stopped(notice.text)
                self._alarms.raise_technical("recording", Priority.MEDIUM, notice.text)
                self._publisher.publish_event(notice.text)

    def _write_completed(self, name: str, sha256: str) -> None:
        """Write a file's SHA-256 into the journal, by which `graspwatch verify` knows it later; no demonstration's."""
        if not name.startswith(DEMO_ID_PREFIX):
            completed = CompletedFile(name=name, sha256=sha256)
            self._publisher.journal.write(JournalKind.EVENT, f"The recording {name} is complete", completed=completed)

    def on_worker_death(self, text: str) -> None:
        """Raise an alarm after the recorder died; `text` is the supervisor's account of the death."""
        self._mark_stopped("the recorder died")
        self._alarms.raise_technical("recorder", Priority.MEDIUM, f"{text} Meanwhile nothing is recorded.")
        self._publisher.publish_event(text)

    def _update_state(self, status: RecorderStatus) -> None:
        begins = status.file is not None and self.state.file is None
        if begins:
            self._alarms.end("recording")
        self.state = RecordingState(
            enabled=self.state.enabled,
            file=status.file,
            samples=status.samples,
            missing_blocks=status.missing_blocks,
            problem=None if begins else self.state.problem,
        )

    def _mark_stopped(self, text: str) -> None:
        self.state = self.state.model_copy(update={"problem": text, "file": None, "samples": 0})

    def _index_file(self, path: Path) -> None:
        reading = asyncio.create_task(asyncio.to_thread(read_file_record, path))
        self._file_read_tasks.add(reading)
        reading.add_done_callback(self._on_file_read)

    def _on_file_read(self, reading: "asyncio.Task[FileRecord]") -> None:
        self._file_read_tasks.discard(reading)
        gone = reading.cancelled() or isinstance(reading.exception(), OSError)
        if not gone:
            self._publisher.index_writer.enqueue(reading.result())

    async def aclose(self) -> None:
        """Put the last recording into the index; call this after the recorder has ended."""
        if self.state.file:
            path = self._recordings_folder / self.state.file
            self._index_file(path)
            if sha256 := await asyncio.to_thread(_digest_if_complete, path):
                self._write_completed(path.name, sha256)
        await asyncio.gather(*self._file_read_tasks, return_exceptions=True)


def _digest_if_complete(path: Path) -> str | None:
    """Return the SHA-256 of a recording, or None if it is not complete or cannot be read."""
    try:
        return digest_file(path) if McapFile(path).complete else None
    except (OSError, RecordingError):
        return None
