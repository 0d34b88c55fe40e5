"""The recorder worker: the process that writes the bus's samples, estimates and messages, run by run."""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import zmq

from acquisition import bus
from acquisition.notices import (
    Acquiring,
    Estimating,
    Notice,
    RecorderStatus,
    RecordingFileClosed,
    RecordingRecovered,
    RecordingStopped,
    RunEnded,
    RunMetadata,
)
from acquisition.worker_life import begin_worker
from acquisition.worker_process import ProcessEndFlag, limit_memory, take_server_priority
from app.messages.runs import RunState
from app.recordings.file_repair import recover_folder
from app.recordings.manifest import digest_file, find_commit
from app.recordings.mcap_writer import RecordingContext
from app.recordings.recorder import Recorder, RecordingStoppedError
from config.schema import Tool
from estimator.estimate_messages import unpack_estimate_rows

READ_PERIOD_S = 0.02
"""Messages are read together at this interval: waking up for each of them costs as much as recording it."""
MAX_MESSAGES_PER_TURN = 100  # so that a backlog does not silence the recorder
MAX_LAST_TURNS = 10
CONNECTION_TIME_S = 1.0  # until the server receives what is published; earlier notices may be lost
STATUS_PERIOD_S = 0.1


@dataclass(frozen=True, slots=True)
class RecorderSetup:
    """Parameters of the recorder worker."""

    parent_pid: int
    endpoints: bus.Endpoints
    folder: Path
    recording_context: RecordingContext
    realtime_priority: bool  # real-time, as the server's

    def with_tool(self, tool: Tool) -> Self:
        return replace(self, recording_context=replace(self.recording_context, tool=tool))


def main(setup: RecorderSetup) -> None:
    """Run until a signal; first repair the files that a previous recorder left cut off."""
    with begin_worker("recorder", setup.parent_pid, setup.endpoints.recorder) as life:
        limit_memory()
        blocks = bus.open_subscriber(life.context, setup.endpoints.samples, setup.endpoints.estimates)
        events = bus.open_subscriber(life.context, setup.endpoints.events)
        _RecorderWorker(setup, life.publisher).run(blocks, events, life.stop)


class _RecorderWorker:
    """Dispatcher of received messages to the recorder, and publisher of the recorder's state."""

    def __init__(self, setup: RecorderSetup, publisher: zmq.Socket) -> None:
        self._setup, self._publisher = setup, publisher
        self._priority = take_server_priority(setup.realtime_priority)
        self._recorder = Recorder(setup.folder, setup.recording_context)
        self._tissues = len(setup.recording_context.library.tissues)
        self._sample_sequence = bus.SequenceTracker()
        self._last_status_s = 0.0

    def run(self, blocks: zmq.Socket, events: zmq.Socket, stop: ProcessEndFlag) -> None:
        """Run until the flag is set, then complete the file."""
        find_commit()  # for the manifests: it may take longer than a run's start allows
        recovered, started_s = list(recover_folder(self._setup.folder)), time.monotonic()
        while not stop.is_set:
            if not self._read_messages(blocks, events):
                time.sleep(READ_PERIOD_S)
            if time.monotonic() - self._last_status_s > STATUS_PERIOD_S:
                self._priority.renew()
                self._publish_status()
            if recovered and time.monotonic() - started_s > CONNECTION_TIME_S:
                self._publish_recovered(recovered.pop())
        for _ in range(MAX_LAST_TURNS):  # what the server said last, such as how the run ended
            if not self._read_messages(blocks, events):
                break
        for path in recovered:
            self._publish_recovered(path)
        self._run_and_report(lambda: self._recorder.close_file("the service was ended"))
        self._publish_status()

    def _publish_recovered(self, path: Path) -> None:
        with contextlib.suppress(FileNotFoundError):  # it was deleted meanwhile
            self._publish_notice(RecordingRecovered(path.name, digest_file(path)))

    def _read_messages(self, blocks: zmq.Socket, events: zmq.Socket) -> bool:
        """Handle the messages that wait, and return whether there may be more.

        Blocks are received first and events handled first. A run is announced before its first block, so the recorder
        then knows the run of every block.
        """
        received = _receive_waiting(blocks)
        for parts in (*_receive_waiting(events), *received):
            self._run_and_report(lambda parts=parts: self._on_message(parts))
        return len(received) == MAX_MESSAGES_PER_TURN

    def _run_and_report(self, work: Callable[[], None]) -> None:
        file = self._recorder.file
        try:
            work()
        except RecordingStoppedError as stopped:
            self._publish_notice(RecordingStopped(str(stopped)))
        if self._recorder.finished_files or self._recorder.file is not file:
            self._publish_status()

    def _on_message(self, parts: list[bytes]) -> None:
        match parts[0]:
            case bus.SAMPLES_TOPIC:
                block = bus.unpack_samples(parts)
                if self._sample_sequence.is_out_of_order(block):
                    return
                if self._sample_sequence.is_restart(block.sequence):
                    self._sample_sequence = bus.SequenceTracker()
                self._sample_sequence.update(block.sequence, block.t_mono_ns)
                self._recorder.add_samples(block)
            case bus.ESTIMATES_TOPIC:
                self._recorder.add_estimates(unpack_estimate_rows(parts, self._tissues))
            case bus.SERVER_MESSAGE_TOPIC:
                self._recorder.add_message(*bus.unpack_server_message(parts))
            case bus.NOTICE_TOPIC:
                match bus.unpack_notice(parts):
                    case RunMetadata() as announced:
                        self._recorder.announce_run(announced)
                    case Acquiring() as notice:
                        self._recorder.realtime["acquisition"] = notice.realtime
                    case Estimating() as notice:
                        self._recorder.realtime["estimator"] = notice.realtime
                    case RunEnded() as ended:
                        self._recorder.on_run_ended(ended.run_id, RunState(ended.end), ended.why)

    def _publish_status(self) -> None:
        """Publish the recorder's state, which is also its sign of life."""
        self._last_status_s = time.monotonic()
        for path, sha256 in self._recorder.finished_files.items():
            self._publish_notice(RecordingFileClosed(path.name, sha256))
        self._recorder.finished_files.clear()
        file = self._recorder.file
        self._publish_notice(
            RecorderStatus(
                file=file.path.name if file else None,
                samples=file.samples if file else 0,
                missing_blocks=self._sample_sequence.missing,
                realtime=str(self._priority),
            )
        )

    def _publish_notice(self, notice: Notice) -> None:
        self._publisher.send_multipart(bus.pack_notice(notice))


def _receive_waiting(socket: zmq.Socket) -> list[list[bytes]]:
    """Return the messages that wait, at most MAX_MESSAGES_PER_TURN."""
    received = []
    while len(received) < MAX_MESSAGES_PER_TURN and socket.poll(0):
        received.append(socket.recv_multipart())
    return received
