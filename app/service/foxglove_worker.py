"""The Foxglove worker: publishes the bus over the Foxglove WebSocket protocol, in the topics of a recording.

Foxglove, Lichtblick and similar programs can connect to it.
"""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass

import foxglove
import numpy as np
import zmq

from acquisition import bus
from acquisition.notices import FoxgloveServing
from acquisition.recordings import mcap_layout
from acquisition.recordings.protobuf_rows import RowLayout
from acquisition.sample_block import SampleBlock
from acquisition.worker_life import begin_worker
from acquisition.worker_process import ProcessEndFlag, limit_memory
from app.recordings.topics import TOPIC_MODELS, build_json_schema
from config.schema import TissueLibrary
from estimator.estimate_messages import unpack_estimate_rows
from estimator.estimate_rows import estimate_columns, row_layouts

HOST = "127.0.0.1"
POLL_MS = 100
STATUS_PERIOD_S = 0.5
MAX_BACKLOG_MESSAGES = 16_384  # five seconds of all topics for a slow reader; after that the oldest are dropped


@dataclass(frozen=True, slots=True)
class FoxgloveSetup:
    """The setup that the worker receives."""

    parent_pid: int
    endpoints: bus.Endpoints
    port: int
    name: str
    library: TissueLibrary
    sample_rate_hz: float


def main(setup: FoxgloveSetup) -> None:
    """Run the worker until a signal ends it."""
    with begin_worker("foxglove", setup.parent_pid, setup.endpoints.foxglove) as life:
        sources = bus.open_subscriber(
            life.context, setup.endpoints.samples, setup.endpoints.estimates, setup.endpoints.events
        )
        server = foxglove.start_server(
            name=setup.name, host=HOST, port=setup.port, message_backlog_size=MAX_BACKLOG_MESSAGES
        )
        stage = FoxglovePublisher(setup.library, setup.sample_rate_hz)
        limit_memory()
        _run(sources, life.publisher, stage, life.stop)
        server.stop()


def _run(
    sources: zmq.Socket, publisher: zmq.Socket, foxglove_publisher: "FoxglovePublisher", stop: ProcessEndFlag
) -> None:
    said_s = 0.0
    while not stop.is_set:
        if sources.poll(POLL_MS):
            foxglove_publisher.process(sources.recv_multipart())
        if time.monotonic() - said_s > STATUS_PERIOD_S:
            said_s = time.monotonic()
            publisher.send_multipart(bus.pack_notice(FoxgloveServing()))


class FoxglovePublisher:
    """A publisher of bus messages on Foxglove channels; it encodes rows only for channels with subscribers."""

    def __init__(self, library: TissueLibrary, sample_rate_hz: float) -> None:
        self._tissues = list(library.tissues)
        self._sample_period_ns = 1e9 / sample_rate_hz
        self._wall_offset_ns = time.time_ns() - time.monotonic_ns()
        self._clock_anchor = (0, time.time_ns())  # a tick and its time, ns since 1970
        self._sample_sequence = bus.SequenceTracker()
        self._row_channels = {topic: _RowChannel(topic, rows) for topic, rows in row_layouts(self._tissues).items()}
        self._message_channels = {
            topic: foxglove.Channel(topic, schema=json.loads(build_json_schema(model)), message_encoding="json")
            for topic, model in TOPIC_MODELS.items()
        }

    def process(self, parts: list[bytes]) -> None:
        match parts[0]:
            case bus.SAMPLES_TOPIC:
                self._process_samples(bus.unpack_samples(parts))
            case bus.ESTIMATES_TOPIC:
                estimates = unpack_estimate_rows(parts, len(self._tissues)).estimates
                self._publish_rows(mcap_layout.ESTIMATES_TOPIC, estimate_columns(estimates, self._tissues))
            case bus.SERVER_MESSAGE_TOPIC:
                topic, content = bus.unpack_server_message(parts)
                self._message_channels[topic].log(content, log_time=time.time_ns())

    def _process_samples(self, block: SampleBlock) -> None:
        if self._sample_sequence.is_out_of_order(block):
            return
        if (
            self._sample_sequence.update(block.sequence, block.t_mono_ns)
            or block.sequence == 1
            or not self._clock_anchor[0]
        ):
            self._clock_anchor = (int(block.samples["tick"][-1]) + 1, block.t_mono_ns + self._wall_offset_ns)
        lost_samples = mcap_layout.count_lost_before([block])
        self._publish_rows(mcap_layout.RAW_TOPIC, mcap_layout.raw_columns(block.samples, lost_samples))
        self._publish_rows(mcap_layout.CONDITIONED_TOPIC, mcap_layout.conditioned_columns(block.samples))

    def _publish_rows(self, topic: str, columns: Mapping[str, np.ndarray]) -> None:
        if self._row_channels[topic].has_subscribers:
            tick, at_ns = self._clock_anchor
            self._row_channels[topic].publish(
                columns, at_ns + np.round((columns["tick"] - tick) * self._sample_period_ns).astype(np.int64)
            )


class _RowChannel:
    """A channel of protobuf rows, encoded as in a recording."""

    def __init__(self, topic: str, rows: RowLayout) -> None:
        schema = foxglove.Schema(name=rows.schema_name, encoding="protobuf", data=rows.descriptor_set)
        self._rows, self._channel = rows, foxglove.Channel(topic, schema=schema, message_encoding="protobuf")

    @property
    def has_subscribers(self) -> bool:
        return self._channel.has_sinks()

    def publish(self, columns: Mapping[str, np.ndarray], log_ns: np.ndarray) -> None:
        data, size = self._rows.encode_rows(columns), self._rows.row_bytes
        for i, at_ns in enumerate(log_ns.tolist()):
            self._channel.log(data[i * size : (i + 1) * size], log_time=at_ns)
