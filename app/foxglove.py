"""The live stream over the Foxglove WebSocket protocol: a process that shows Foxglove, Lichtblick and the like what the
bus carries, in the topics of a recording."""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass

import foxglove
import numpy as np
import zmq

from acquisition import bus
from acquisition.blocks import SampleBlock
from acquisition.process import StopFlag, become_worker, bound_memory
from acquisition.recordings import layout
from acquisition.recordings.rows import RowLayout
from app.record.topics import TOPICS, schema_of
from config.schema import TissueLibrary
from estimator.blocks import estimate_dtype
from estimator.recorded import estimate_columns, row_layouts

HOST = "127.0.0.1"
POLL_MS = 100
SAYS_EVERY_S = 0.5
MESSAGES_KEPT = 16_384  # five seconds of all topics, for a reader that is slow; after that the oldest are dropped


@dataclass(frozen=True, slots=True)
class Setup:
    """All that the worker needs to know."""

    parent_pid: int
    endpoints: bus.Endpoints
    port: int
    name: str
    library: TissueLibrary
    sample_rate_hz: float


def main(setup: Setup) -> None:
    """Run until a signal."""
    stop = become_worker("foxglove", setup.parent_pid)
    context = zmq.Context()
    publisher = bus.publisher(context, setup.endpoints.foxglove)
    sources = bus.subscriber(context, setup.endpoints.samples, setup.endpoints.estimates, setup.endpoints.events)
    server = foxglove.start_server(name=setup.name, host=HOST, port=setup.port, message_backlog_size=MESSAGES_KEPT)
    stage = Stage(setup.library, setup.sample_rate_hz)
    bound_memory()
    _follow(sources, publisher, stage, stop)
    server.stop()
    context.destroy(linger=100)


def _follow(sources: zmq.Socket, publisher: zmq.Socket, stage: "Stage", stop: StopFlag) -> None:
    said_s = 0.0
    while not stop.set:
        if sources.poll(POLL_MS):
            stage.take(sources.recv_multipart())
        if time.monotonic() - said_s > SAYS_EVERY_S:
            said_s = time.monotonic()
            publisher.send_multipart(bus.pack_notice("streaming"))


class Stage:
    """Puts each message of the bus on its channel, if anybody listens to that."""

    def __init__(self, library: TissueLibrary, sample_rate_hz: float) -> None:
        self._tissues = list(library.tissues)
        self._dtype = estimate_dtype(len(self._tissues))
        self._step_ns = 1e9 / sample_rate_hz
        self._wall_offset_ns = time.time_ns() - time.monotonic_ns()
        self._anchor = (0, time.time_ns())  # a tick and its time, ns since 1970
        self._sequence = bus.SequenceCounter()
        self._rows = {topic: _Rows(topic, rows) for topic, rows in row_layouts(self._tissues).items()}
        self._told = {
            topic: foxglove.Channel(topic, schema=json.loads(schema_of(model)), message_encoding="json")
            for topic, model in TOPICS.items()
        }

    def take(self, parts: list[bytes]) -> None:
        match parts[0]:
            case bus.SAMPLES:
                self._take_samples(bus.unpack_samples(parts))
            case bus.ESTIMATES:
                estimates = np.frombuffer(parts[2], self._dtype)
                self._show(layout.ESTIMATES, estimate_columns(estimates, self._tissues))
            case bus.TOLD:
                topic, content = bus.unpack_told(parts)
                self._told[topic].log(content, log_time=time.time_ns())

    def _take_samples(self, block: SampleBlock) -> None:
        if self._sequence.is_out_of_turn(block):
            return
        if self._sequence.take(block.sequence, block.t_mono_ns) or block.sequence == 1 or not self._anchor[0]:
            self._anchor = (int(block.samples["tick"][-1]) + 1, block.t_mono_ns + self._wall_offset_ns)
        self._show(layout.RAW, layout.raw_columns(block))
        self._show(layout.CONDITIONED, layout.conditioned_columns(block))

    def _show(self, topic: str, columns: Mapping[str, np.ndarray]) -> None:
        if self._rows[topic].is_wanted:
            tick, at_ns = self._anchor
            self._rows[topic].show(columns, at_ns + np.round((columns["tick"] - tick) * self._step_ns).astype(np.int64))


class _Rows:
    """A topic of rows, as in a recording."""

    def __init__(self, topic: str, rows: RowLayout) -> None:
        schema = foxglove.Schema(name=rows.schema_name, encoding="protobuf", data=rows.descriptor_set)
        self._rows, self._channel = rows, foxglove.Channel(topic, schema=schema, message_encoding="protobuf")

    @property
    def is_wanted(self) -> bool:
        return self._channel.has_sinks()

    def show(self, columns: Mapping[str, np.ndarray], log_ns: np.ndarray) -> None:
        data, size = self._rows.encode(columns), self._rows.row_bytes
        for i, at_ns in enumerate(log_ns.tolist()):
            self._channel.log(data[i * size : (i + 1) * size], log_time=at_ns)
