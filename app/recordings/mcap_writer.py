"""Writer of one run's MCAP file: raw and conditioned samples, estimates, messages and journal lines."""

import contextlib
import fcntl
import hashlib
import io
import json
import os
import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from mcap.writer import CompressionType, Writer
from pydantic import ValidationError

from acquisition.recordings import mcap_layout
from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.protobuf_rows import RowLayout
from acquisition.recordings.recording import read_recorded_tool
from acquisition.sample_block import SampleBlock
from app import __version__
from app.recordings.manifest import build_manifest, collect_versions
from app.recordings.topics import SCHEMA_NAMES, TOPIC_MODELS, build_json_schema
from config.errors import RecordingError
from config.schema import Settings, TissueLibrary, Tool
from estimator.estimate_messages import PublishedEstimates
from estimator.estimate_rows import estimate_columns, row_layouts

RECORDING_SUFFIX = ".mcap"
CHUNK_BYTES = 4 * 2**20  # never reached: each flush ends a chunk
FLUSH_PERIOD_S = 0.25
MAX_BLOCKS_PER_FLUSH = 200  # three times the blocks that arrive between two flushes
SYNC_TIMEOUT_S = 2.0
"""Time that a disk may take for a flush; after it, the next flush waits for the disk and the recorder falls silent."""


@dataclass(frozen=True, slots=True)
class RecordingContext:
    """Configuration that a recording is made with."""

    tool: Tool
    library: TissueLibrary
    settings: Settings

    @classmethod
    def from_recording(cls, container: McapFile) -> Self:
        """Return the configuration that a file was recorded with.

        Raises:
            RecordingError: the file lacks it, or this version cannot read it.
        """
        try:
            return cls(
                read_recorded_tool(container),
                TissueLibrary.model_validate_json(
                    container.attachments[mcap_layout.LIBRARY_ATTACHMENT], extra="ignore"
                ),
                Settings.model_validate_json(container.attachments[mcap_layout.SETTINGS_ATTACHMENT], extra="ignore"),
            )
        except (KeyError, ValidationError) as error:
            why = str(error).splitlines()[0]
            raise RecordingError(
                f"{container.path}: what it was recorded with cannot be read ({why}). Leave --as-recorded out."
            ) from None

    def attachments(self) -> dict[str, bytes]:
        return {
            mcap_layout.TOOL_ATTACHMENT: self.tool.model_dump_json(indent=2).encode(),
            mcap_layout.LIBRARY_ATTACHMENT: self.library.model_dump_json(indent=2).encode(),
            mcap_layout.SETTINGS_ATTACHMENT: self.settings.model_dump_json(indent=2).encode(),
            mcap_layout.VERSIONS_METADATA_NAME: json.dumps(collect_versions(), indent=2).encode(),
        }


class HashingFile(io.FileIO):
    """A file that is written from its beginning to its end, and the SHA-256 of what was written."""

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises:
            OSError: it cannot be created, or exists.
        """
        super().__init__(path, "xb")
        self.sha256 = hashlib.sha256()

    def write(self, data: Any, /) -> int:
        written = super().write(data)
        self.sha256.update(memoryview(data)[:written])
        return written


class McapRunWriter:
    """Writer of one file. Each `flush` sends added data to the disk; `close` completes the file."""

    def __init__(
        self,
        path: Path,
        recording_context: RecordingContext,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        wall_offset_ns: int,
        *,
        realtime: Mapping[str, str] | None = None,
    ) -> None:
        """`metadata`: run id, first tick of the run and the like; `wall_offset_ns`: from `t_mono_ns` to ns since 1970.

        `realtime`: scheduling that the system granted each process, for the manifest.

        Raises:
            OSError: the file cannot be created; an existing file is never overwritten.
        """
        self.path = path
        self.samples = self.lost_samples = 0
        self._absent_samples, self._next_tick = 0, -1  # missing between the blocks, whatever the reason
        self._wall_offset_ns = wall_offset_ns  # constant, because the computer's clock may be set meanwhile
        self._tissues = list(recording_context.library.tissues)
        self._sample_period_ns = 1e9 / recording_context.tool.board.sample_rate_hz
        self._clock_anchor: tuple[int, int] | None = None  # a tick and its time, ns since 1970
        self._pending_samples: list[SampleBlock] = []  # until the next flush
        self._pending_estimates: list[PublishedEstimates] = []
        self._hashing_file = HashingFile(path)
        self._file = io.BufferedWriter(self._hashing_file)
        self._sync_executor = ThreadPoolExecutor(1, "disk")
        self._sync_future: Future[None] | None = None  # the last sync
        self._sync_started_s = 0.0
        try:
            self._begin_file(recording_context, metadata, attachments, realtime or {})
        except BaseException:  # a file that does not even begin is of no use, and would be in the way of another try
            self.abandon()
            path.unlink(missing_ok=True)
            raise

    def _begin_file(
        self,
        recording_context: RecordingContext,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        realtime: Mapping[str, str],
    ) -> None:
        """Write what the file says of itself, and declare its topics."""
        fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # until this process closes it or dies
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(mcap_layout.PROFILE, f"graspwatch {__version__}")
        metadata = self._build_metadata(recording_context, metadata)
        self._writer.add_metadata(mcap_layout.METADATA_NAME, metadata)
        now_ns, attachments = time.time_ns(), {**recording_context.attachments(), **attachments}
        manifest = build_manifest(metadata, attachments, realtime)
        attachments[mcap_layout.MANIFEST_ATTACHMENT] = manifest.model_dump_json(indent=2).encode()
        for name, data in attachments.items():
            self._writer.add_attachment(now_ns, now_ns, name, "application/json", data)
        self._layouts = row_layouts(self._tissues)
        self._row_channels = {topic: self._register_channel(topic, rows) for topic, rows in self._layouts.items()}
        self._message_channels = {
            topic: self._writer.register_channel(
                topic, "json", self._writer.register_schema(SCHEMA_NAMES[topic], "jsonschema", build_json_schema(model))
            )
            for topic, model in TOPIC_MODELS.items()
        }
        self.flush()

    def _build_metadata(self, recording_context: RecordingContext, metadata: Mapping[str, str]) -> dict[str, str]:
        calibration = recording_context.tool.calibration
        return {
            "format_version": str(mcap_layout.FORMAT_VERSION),
            "graspwatch": __version__,
            "tool": recording_context.tool.name,
            "library": recording_context.library.name,
            "calibrated": calibration.date,
            "calibrated_by": calibration.person,
            "force_scale": recording_context.tool.scale_text,
            "sample_rate_hz": f"{recording_context.tool.board.sample_rate_hz:g}",
            "clock": "log time: the sample clock, set to the computer's clock at the first sample; "
            "publish time: the computer's clock when the block had been read",
            **metadata,
        }

    def _register_channel(self, topic: str, rows: RowLayout) -> int:
        schema = self._writer.register_schema(rows.schema_name, "protobuf", rows.descriptor_set)
        return self._writer.register_channel(topic, "protobuf", schema)

    def add_samples(self, block: SampleBlock) -> None:
        """Add a block of samples."""
        if self._clock_anchor is None:
            last_tick = int(block.samples["tick"][-1])
            self._clock_anchor = (last_tick + 1, block.t_mono_ns + self._wall_offset_ns)
        first_tick = int(block.samples["tick"][0])
        self._absent_samples += first_tick - self._next_tick if self._next_tick >= 0 else 0
        self._next_tick = int(block.samples["tick"][-1]) + 1
        self.samples += len(block.samples)
        self.lost_samples += block.lost_samples
        self._pending_samples.append(block)

    def add_estimates(self, estimates: PublishedEstimates) -> None:
        """Add the estimates of a block."""
        self._pending_estimates.append(estimates)

    def add_message(self, topic: str, content: bytes, at_ns: int) -> None:
        """Add a JSON message; `at_ns` by the computer's clock."""
        self._writer.add_message(self._message_channels[topic], at_ns, content, at_ns)

    def flush(self, *, sync: bool = True) -> None:
        """Write the oldest added data, which then outlive this process, and with `sync` soon the computer.

        One call writes at most MAX_BLOCKS_PER_FLUSH blocks a topic, so that a backlog does not silence the recorder.

        Raises:
            OSError: the disk is full or gone; a later flush may raise it instead.
        """
        self._write_samples()
        self._write_estimates()
        self._writer.flush()
        if sync:
            self._sync()

    def _sync(self) -> None:
        """Sync the written data in a thread: waiting for a slow disk would make the recorder seem to hang."""
        if self._sync_future:
            if not self._sync_future.done() and time.monotonic() - self._sync_started_s < SYNC_TIMEOUT_S:
                return
            self._sync_future.result()
        self._sync_future = self._sync_executor.submit(os.fdatasync, self._file.fileno())
        self._sync_started_s = time.monotonic()

    def _write_samples(self) -> None:
        blocks = self._pending_samples[:MAX_BLOCKS_PER_FLUSH]
        if not blocks:
            return
        samples = np.concatenate([block.samples for block in blocks])
        lost_samples = mcap_layout.count_lost_before(blocks)
        origins = [(len(block.samples), block.sequence, block.t_mono_ns) for block in blocks]
        self._write_rows(mcap_layout.RAW_TOPIC, mcap_layout.raw_columns(samples, lost_samples), origins)
        self._write_rows(mcap_layout.CONDITIONED_TOPIC, mcap_layout.conditioned_columns(samples), origins)
        del self._pending_samples[: len(blocks)]

    def _write_estimates(self) -> None:
        blocks = self._pending_estimates[:MAX_BLOCKS_PER_FLUSH]
        if not blocks:
            return
        columns = estimate_columns(np.concatenate([block.estimates for block in blocks]), self._tissues)
        origins = [(len(block.estimates), block.sequence, block.published_ns) for block in blocks]
        self._write_rows(mcap_layout.ESTIMATES_TOPIC, columns, origins)
        del self._pending_estimates[: len(blocks)]

    def _write_rows(self, topic: str, columns: Mapping[str, np.ndarray], origins: list[tuple[int, int, int]]) -> None:
        """Write rows of a topic; `origins`: of each block the length, number, and time of publication, ns."""
        tick, at_ns = self._clock_anchor or (int(columns["tick"][0]), time.time_ns())
        log_ns = at_ns + np.round((columns["tick"] - tick) * self._sample_period_ns).astype(np.int64)
        data, size = self._layouts[topic].encode_rows(columns), self._layouts[topic].row_bytes
        lengths, sequences, published_ns = np.array(origins).T
        sequence_of_row = np.repeat(sequences, lengths).tolist()
        published_of_row = np.repeat(published_ns + self._wall_offset_ns, lengths).tolist()
        add, channel = self._writer.add_message, self._row_channels[topic]
        for i, (at, published, sequence) in enumerate(
            zip(log_ns.tolist(), published_of_row, sequence_of_row, strict=True)
        ):
            add(channel, at, data[i * size : (i + 1) * size], published, sequence)

    def close(self, **end_metadata: str) -> str:
        """Complete the file with the run's end; return its SHA-256.

        Raises:
            OSError: the disk is full or gone; the file is readable up to its last flush.
        """
        try:
            while self._pending_samples or self._pending_estimates:
                self.flush(sync=False)
            if self._sync_future:
                self._sync_future.result()
            counts = {
                "samples": str(self.samples),
                "lost_samples": str(self.lost_samples),
                "absent_samples": str(self._absent_samples),
            }
            self._writer.add_metadata(mcap_layout.END_METADATA_NAME, counts | end_metadata)
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            return self._hashing_file.sha256.hexdigest()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file without completing it: it is readable up to its last flush."""
        self._sync_executor.shutdown()
        with contextlib.suppress(OSError):  # no room for the rest of its buffer
            self._file.close()
