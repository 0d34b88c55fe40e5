"""The class Publisher, which sends the server's messages to viewers, recorder and index, and events to the journal."""

import zmq
from pydantic import BaseModel

from acquisition import bus
from acquisition.notices import RunMetadata
from app.audit.journal import Journal
from app.host.clock import now_ms
from app.index.index_writer import IndexWriter
from app.index.ingest import IndexedMessage
from app.index.rebuild import BEHIND_MARKER_FILE
from app.index.store import Store
from app.messages.journal import JournalEntry, JournalKind
from app.messages.live import EventMessage
from app.messages.runs import Run
from app.recordings.topics import MARK_TOPIC, build_foxglove_event, encode_message, find_topic
from app.stream.alarms import AlarmManager
from app.stream.viewers import ViewerHub
from config.service_plan import ServicePlan
from estimator.force_alarms import Priority

CLOSE_TIMEOUT_MS = 200  # for the last messages to the recorder


class Publisher:
    """Publisher of the server's messages; it owns the viewers, the journal, the index writer and the alarms."""

    def __init__(self, plan: ServicePlan, store: Store, address: str) -> None:
        """`address`: where the recorder and the Foxglove server subscribe to messages."""
        self._context = zmq.Context()
        self._socket = bus.open_publisher(self._context, address)
        self.viewer_hub = ViewerHub(plan.settings.server.chart_window_frames)
        self.index_writer = IndexWriter(store, plan.data_folder / BEHIND_MARKER_FILE, self._on_index_fault)
        self.journal = Journal(plan.data_folder, self._on_journal_fault, self.record)
        self.alarms = AlarmManager(self.publish, self.journal)

    def publish(self, message: BaseModel) -> None:
        """Send a message to the viewers, the recorder and the index."""
        self.viewer_hub.broadcast(message)
        self.record(message)

    def record(self, message: BaseModel) -> None:
        """Send a message to the recorder and the index, as far as they keep its kind."""
        topic = find_topic(message)
        if topic:
            self._send(bus.pack_server_message(topic, encode_message(message)))
        if isinstance(message, JournalEntry) and message.mark and message.mark.version == 1:
            self._send(bus.pack_server_message(MARK_TOPIC, encode_message(build_foxglove_event(message.mark))))
        if isinstance(message, IndexedMessage):
            self.index_writer.enqueue(message)

    def announce_run(self, run_metadata: RunMetadata) -> None:
        """Announce a run to the recorder; call this before the acquisition starts the run."""
        self._send(bus.pack_notice(run_metadata))

    def publish_event(
        self, text: str, kind: JournalKind = JournalKind.EVENT, by: str | None = None, run: Run | None = None
    ) -> None:
        """Write an event to the journal and send it to the viewers."""
        self.journal.write(kind, text, by=by, run=run)
        self.viewer_hub.broadcast(EventMessage(server_time_ms=now_ms(), text=f"{text}, by {by}" if by else text))

    def close(self) -> None:
        """Close the socket; the index writer is closed by its owner, after all others."""
        self._context.destroy(linger=CLOSE_TIMEOUT_MS)

    def _send(self, parts: list[bytes]) -> None:
        self._socket.send_multipart(parts)  # never blocks: a PUB socket drops messages for a reader that hangs

    def _on_journal_fault(self, fault: str | None) -> None:
        self.alarms.update_technical("journal", Priority.LOW, fault)

    def _on_index_fault(self, fault: str | None) -> None:
        self.alarms.update_technical("index", Priority.LOW, fault)
