"""The class Recorder, which writes one file a run, with the samples right before and after it."""

import contextlib
import time
from collections import deque
from datetime import UTC, datetime
from pathlib import Path

from acquisition.notices import RunMetadata
from acquisition.recordings import mcap_layout
from acquisition.recordings.file_names import DEMO_ID_PREFIX
from acquisition.sample_block import SampleBlock
from app.host.disk import free_bytes
from app.messages.runs import Run, RunState
from app.messages.stored import read_stored
from app.recordings.mcap_writer import FLUSH_PERIOD_S, RECORDING_SUFFIX, McapRunWriter, RecordingContext
from app.recordings.topics import RUN_TOPIC, encode_message
from config.schema import GraspProtocol
from estimator.estimate_messages import PublishedEstimates

RUN_END_TIMEOUT_S = 10.0  # time limit for a hanging server to report a run's end
MAX_ANNOUNCED_RUNS = 20
LATE_DATA_GRACE_S = 0.2  # estimates come after their samples, and messages of a run after its last sample


class RecordingStoppedError(Exception):
    """A recording ended before its run; the text says why, and what to do."""


class Recorder:
    """Recorder of samples, estimates and messages, passed in order; it writes a file for each run.

    Every method but `announce_run` may raise RecordingStoppedError: it closes that file, and records later runs again.
    """

    def __init__(self, folder: Path, recording_context: RecordingContext) -> None:
        self._folder, self._recording_context = folder, recording_context
        rate_hz = recording_context.tool.board.sample_rate_hz
        self._recording_settings = recording_context.settings.recording
        self._before_samples = int(self._recording_settings.before_s * rate_hz)
        self._after_samples = int(self._recording_settings.after_s * rate_hz)
        self._grace_samples, self._run_end_timeout_samples = (
            int(LATE_DATA_GRACE_S * rate_hz),
            int(RUN_END_TIMEOUT_S * rate_hz),
        )
        self._last_sequence = 0  # of the block written last
        self._recent_blocks: deque[SampleBlock] = deque()
        self._recent_estimates: deque[PublishedEstimates] = deque()
        self._early_estimates: deque[PublishedEstimates] = deque()  # estimates of blocks that are still to come
        self._announced_runs: dict[str, RunMetadata] = {}  # the last ones; in a backlog they come before their blocks
        self._newest_announced_id = ""
        self._pending_messages: list[tuple[str, bytes, int]] = []  # since the announcement, until the run begins
        self._wall_offset_ns = time.time_ns() - time.monotonic_ns()
        self._current_run_id = ""
        self._end_tick: int | None = None  # None while the run goes on
        self._last_run_message: Run | None = None  # from the server
        self._acquisition_run_end: Run | None = None  # the same with the end that the acquisition reported
        self._last_flush_s = 0.0
        self.file: McapRunWriter | None = None
        self.realtime: dict[str, str] = {}  # scheduling that the system granted each process, for the manifest
        self.finished_files: dict[Path, str | None] = {}
        """Files that were finished since the worker last cleared this, with their SHA-256; None: not complete."""

    def announce_run(self, run_metadata: RunMetadata) -> None:
        """Store the description of a run that is about to begin."""
        self._announced_runs[run_metadata.run_id] = run_metadata
        self._newest_announced_id = run_metadata.run_id
        for oldest in list(self._announced_runs)[:-MAX_ANNOUNCED_RUNS]:
            del self._announced_runs[oldest]
        self._pending_messages = []

    def add_samples(self, block: SampleBlock) -> None:
        """Add a block of samples; its ticks also start and end the files."""
        if self._recent_blocks and block.sequence <= self._recent_blocks[-1].sequence:  # the acquisition was restarted
            self.close_file("the acquisition worker was restarted")
            self._recent_blocks.clear()
            self._recent_estimates.clear()
        begins, self._current_run_id = block.run not in ("", self._current_run_id), block.run or self._current_run_id
        tick = int(block.samples["tick"][0])
        try:
            if begins:
                self.close_file("the next run began")
                self._start_file(block)
            elif self.file and not block.run and self._end_tick is None:
                self._end_tick = tick + self._after_samples
            if self.file and self._end_tick is not None and tick >= self._end_tick + self._wait_samples:
                self.close_file()
            if self.file and (self._end_tick is None or tick < self._end_tick):
                self.file.add_samples(block)
                self._last_sequence = block.sequence
                while self._early_estimates and self._early_estimates[0].sequence <= block.sequence:
                    self._write_estimates(self._early_estimates.popleft())
        finally:
            self._buffer_block(block)
        self._flush_if_due()

    def add_estimates(self, estimated: PublishedEstimates) -> None:
        """Add a block's estimates, which mostly come before its samples; in a backlog the order is arbitrary."""
        self._recent_estimates.append(estimated)
        if self.file and estimated.sequence <= self._last_sequence:
            self._write_estimates(estimated)
        elif self.file:
            self._early_estimates.append(estimated)

    def _write_estimates(self, estimated: PublishedEstimates) -> None:
        assert self.file is not None
        self.file.add_estimates(estimated)

    def add_message(self, topic: str, content: bytes) -> None:
        """Add a message of a topic of `app/recordings/topics.py`."""
        at_ns = time.monotonic_ns() + self._wall_offset_ns
        if topic == RUN_TOPIC:
            self._last_run_message = read_stored(Run, content)
        if self.file:
            self.file.add_message(topic, content, at_ns)
        if self._newest_announced_id not in ("", self._current_run_id):
            self._pending_messages.append((topic, content, at_ns))

    def on_run_ended(self, run_id: str, end: RunState, why: str) -> None:
        """Store the acquisition's report of a run's end, for the case that the server hangs and does not send it."""
        if self._last_run_message and self._last_run_message.id == run_id:
            update = {"state": end, "why": why, "ended_at": datetime.now(UTC).isoformat()}
            self._acquisition_run_end = self._last_run_message.model_copy(update=update)

    @property
    def _unreported_run_end(self) -> Run | None:
        """A run's end that the server has not reported yet."""
        told, end = self._last_run_message, self._acquisition_run_end
        return end if told and end and told.id == end.id and told.state is RunState.RUNNING else None

    @property
    def _wait_samples(self) -> int:
        """Number of samples to wait for messages after a file's last sample."""
        return self._run_end_timeout_samples if self._unreported_run_end else self._grace_samples

    def close_file(self, why: str = "") -> None:
        """Complete the file, if one is open."""
        if self.file is None:
            return
        if untold := self._unreported_run_end:
            self.add_message(RUN_TOPIC, encode_message(untold))
        file, self.file, self._end_tick = self.file, None, None
        self._early_estimates.clear()
        self.finished_files[file.path] = None
        try:
            self.finished_files[file.path] = file.close(why=why) if why else file.close()
        except OSError as error:
            raise self._make_stopped_error(file.path, error) from None
        if file.path.name.startswith(DEMO_ID_PREFIX):
            with contextlib.suppress(OSError):  # another process may delete them, too, or none may
                self._delete_old_demos()

    def _start_file(self, block: SampleBlock) -> None:
        """Open a file for the run that begins with this block, and write the samples right before it."""
        self._end_tick = None
        if not self._recording_settings.enabled:
            return
        free = free_bytes(self._folder)
        least = self._recording_settings.least_free_bytes
        if free is None or free < least:
            raise RecordingStoppedError(
                f"Run {block.run} is not recorded: the disk of {self._folder} has fewer than {least / 1e6:.0f} MB "
                "free. Make room."
            )
        known = self._announced_runs.get(block.run)
        first = self._recent_blocks[0] if self._recent_blocks else block
        about = {
            "run_id": block.run,
            "run_first_tick": str(int(block.samples["tick"][0])),
            "first_tick": str(int(first.samples["tick"][0])),
            "wall_offset_ns": str(self._wall_offset_ns),
        }
        attachments = {}
        if known:
            about |= {"cycles": str(known.cycles), "tissue": known.tissue or "", "by": known.by or ""}
            about["protocol"] = GraspProtocol.model_validate_json(known.protocol).name
            attachments[mcap_layout.PROTOCOL_ATTACHMENT] = known.protocol.encode()
            if known.reference:
                attachments[mcap_layout.REFERENCE_ATTACHMENT] = known.reference.encode()
            if known.session:
                attachments[mcap_layout.SESSION_ATTACHMENT] = known.session.encode()
        path = self._find_unused_path(block.run)
        if path.stem != block.run:
            about["continues"] = block.run
        try:
            self.file = McapRunWriter(
                path, self._recording_context, about, attachments, self._wall_offset_ns, realtime=self.realtime
            )
        except OSError as error:
            raise self._make_stopped_error(path, error) from None
        for before in self._recent_blocks:
            self.file.add_samples(before)
            self._last_sequence = before.sequence
        for told in self._pending_messages:
            self.file.add_message(*told)
        self._pending_messages = []
        for estimated in self._recent_estimates:
            self._write_estimates(estimated)

    def _find_unused_path(self, run_id: str) -> Path:
        """Return the run's file name, with a part number if it exists: a recorder before this one was cut off."""
        names = (f"{run_id}{part}{RECORDING_SUFFIX}" for part in ("", *(f"-part{n}" for n in range(2, 1000))))
        return next(path for name in names if not (path := self._folder / name).exists())

    def _buffer_block(self, block: SampleBlock) -> None:
        """Keep the last seconds for the next file."""
        self._recent_blocks.append(block)
        oldest = int(block.samples["tick"][-1]) - self._before_samples  # the last one that is not needed
        while self._recent_blocks and int(self._recent_blocks[0].samples["tick"][-1]) <= oldest:
            self._recent_blocks.popleft()
        first = self._recent_blocks[0].sequence if self._recent_blocks else block.sequence + 1
        while self._recent_estimates and self._recent_estimates[0].sequence < first:
            self._recent_estimates.popleft()

    def _flush_if_due(self) -> None:
        if self.file is None or time.monotonic() - self._last_flush_s < FLUSH_PERIOD_S:
            return
        self._last_flush_s = time.monotonic()
        path = self.file.path
        try:
            self.file.flush()
            free = free_bytes(self._folder)
        except OSError as error:
            file, self.file = self.file, None
            file.abandon()
            self.finished_files[path] = None
            raise self._make_stopped_error(path, error) from None
        if free is not None and free < self._recording_settings.least_free_bytes:
            self.close_file("the disk is nearly full")
            raise RecordingStoppedError(
                f"The recording {path.name} was ended, the run goes on: the disk of {self._folder} has fewer than "
                f"{self._recording_settings.least_free_bytes / 1e6:.0f} MB free. Make room."
            )

    def _make_stopped_error(self, path: Path, error: OSError) -> RecordingStoppedError:
        return RecordingStoppedError(
            f"The recording {path.name} stopped ({error.strerror}), the run goes on: what was written before can be "
            f"read. Mend the disk of {self._folder}, or make room."
        )

    def _delete_old_demos(self) -> None:
        """Delete old recordings of demonstrations, which go on all day without a person's request."""
        shown = sorted(
            self._folder.glob(f"{DEMO_ID_PREFIX}*{RECORDING_SUFFIX}"), key=lambda path: path.stat().st_mtime_ns
        )
        for path in shown[: max(len(shown) - self._recording_settings.demonstrations_kept, 0)]:
            path.unlink(missing_ok=True)
