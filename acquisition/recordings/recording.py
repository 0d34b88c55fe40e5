"""The class RecordingSource: a recording as a sample source, which gives its raw samples block by block."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from pydantic import ValidationError

from acquisition.drivers.command_history import AppliedCommand
from acquisition.drivers.source import RawBlock
from acquisition.recordings.file_names import has_table_suffix, is_reference_run
from acquisition.recordings.labview import MAX_TIME_STEP_S, read_labview_log
from acquisition.recordings.labview_text import starts_like_labview
from acquisition.recordings.mcap_layout import (
    OPTIONAL_COLUMNS,
    RAW_LAYOUT,
    RAW_TOPIC,
    REFERENCE_ATTACHMENT,
    TOOL_ATTACHMENT,
)
from acquisition.recordings.mcap_reader import COPY_AGAIN_TEXT, MAGIC, McapFile
from acquisition.recordings.sample_log import SampleLog
from acquisition.recordings.table_log import read_table_log
from acquisition.signal_table import SENSOR_SIGNALS
from config.errors import RecordingError
from config.schema import ReferenceGrasp, SourceConditions, Tool

BLOCK_SAMPLES = 100
STEP_SAMPLES = 5  # later stages work in steps that end at ticks that are multiples of this, and at a block's end


@dataclass(frozen=True, slots=True)
class _RecordedSamples:
    """Raw samples of a recording; ticks count from its first sample.

    `signals` holds an array of shape (n,) for each of SENSOR_SIGNALS, NaN where not recorded; `limiter_flags` and
    `limit_n` (N, NaN where not recorded) have shape (n,). `block_ends` are rows behind which a block ended at no
    multiple of STEP_SAMPLES. `run_ids_by_row` holds the run that begins at a row.
    """

    ticks: np.ndarray
    signals: dict[str, np.ndarray]
    limiter_flags: np.ndarray
    limit_n: np.ndarray
    block_ends: np.ndarray
    run_ids_by_row: dict[int, str]
    start_ns: int | None  # time of the first sample, ns since 1970


class RecordingSource:
    """A recording as a sample source; `speed` 1 plays it in real time, None unthrottled.

    An MCAP file holds the tool that it was recorded with; for another program's log (LabVIEW, or a table as the tool
    file describes it), the caller passes it as `tool`.
    """

    def __init__(self, path: Path, tool: Tool, speed: float | None = None) -> None:
        """Open and read the recording.

        Raises:
            RecordingError: the file cannot be read, or is no recording; the text names the place.
        """
        self.path = path
        self.mcap_file = McapFile(path) if is_mcap(path) else None
        self.first_tick = 0  # tick in an MCAP file that counts as 0 here
        self.tool = tool if self.mcap_file is None else read_recorded_tool(self.mcap_file)
        self.log: SampleLog | None = None if self.mcap_file else read_log(path, tool)
        self._recorded = self._read()
        self._rate_hz = self.tool.board.sample_rate_hz
        if self.duration_s > MAX_TIME_STEP_S:
            raise RecordingError(
                f"{path}: spans more than {MAX_TIME_STEP_S / 3600:.0f} hours. Split it, or mend its times."
            )
        self._speed = speed
        self._block_samples = BLOCK_SAMPLES if speed is None else self.tool.board.block_samples
        self._row = self._skipped_rows = 0
        self._run_id = ""
        self._started_s = 0.0

    def _read(self) -> _RecordedSamples:
        if self.mcap_file is None:
            assert self.log
            ticks, signals = self.log.ticks, _complete_signals(self.log.signals)
            held, limit_n = np.zeros(len(ticks), np.uint16), np.full(len(ticks), np.nan)
            return _RecordedSamples(ticks, signals, held, limit_n, np.zeros(0, np.int64), {}, self._find_log_start_ns())
        rows = self.mcap_file.read_rows(RAW_TOPIC)
        missing = {column.path for column in RAW_LAYOUT.columns} - set(rows.columns) - OPTIONAL_COLUMNS
        if missing:
            raise RecordingError(f"{self.path}: lacks {', '.join(sorted(missing))}: not all that a replay needs.")
        ticks, about = rows.columns["tick"], self.mcap_file.metadata
        if (np.diff(ticks) < 1).any():
            raise RecordingError(f"{self.path}: its samples are not in the order of time.")
        self.first_tick = int(ticks[0] - ticks[0] % STEP_SAMPLES)
        try:
            begins, run_id = int(np.searchsorted(ticks, int(about["run_first_tick"]))), about["run_id"]
        except (KeyError, ValueError, OverflowError):
            raise RecordingError(f"{self.path}: does not say where its run begins. {COPY_AGAIN_TEXT}") from None
        ends = np.flatnonzero(np.diff(rows.sequence)) + 1
        ends = ends[ticks[ends - 1] % STEP_SAMPLES != STEP_SAMPLES - 1]
        signals = _complete_signals(rows.columns)
        runs = {begins: run_id} if begins < len(ticks) else {}
        limiter = rows.columns["limiter_flags"].astype(np.uint16)
        limit_n = rows.columns.get("limit_n", np.full(len(ticks), np.nan))
        start_ns = int(rows.log_ns[0])
        return _RecordedSamples(ticks - self.first_tick, signals, limiter, limit_n, ends, runs, start_ns)

    def _find_log_start_ns(self) -> int | None:
        assert self.log
        try:
            return self.log.find_start_ns()[0]
        except RecordingError:  # a clock that was never set, for example: the samples are sound
            return None

    def __enter__(self) -> Self:
        self._started_s = time.monotonic()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return

    @property
    def conditions(self) -> SourceConditions:
        """When the recording was made, and its reference grasp.

        The time is None if a log does not say it in a way that can be read; a log holds no reference.

        Raises:
            RecordingError: the reference grasp in the file cannot be read.
        """
        start_ns = self._recorded.start_ns
        recorded_at = None if start_ns is None else datetime.fromtimestamp(start_ns // 1000 / 1e6, UTC)
        return SourceConditions(recorded_at, read_recorded_reference(self.mcap_file) if self.mcap_file else None)

    @property
    def is_reference_grasp(self) -> bool:
        """Whether the recorded run is a reference grasp, with empty jaws."""
        return any(map(is_reference_run, self._recorded.run_ids_by_row.values()))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was converted when the file was read, in words."""
        return self.log.remarks if self.log else ()

    @property
    def sample_count(self) -> int:
        """Number of samples without those skipped."""
        return len(self._recorded.ticks) - self._skipped_rows

    @property
    def duration_s(self) -> float:
        return float(self._recorded.ticks[-1] + 1) / self._rate_hz

    def skip_to_run(self) -> None:
        """Skip the samples before the run, because its estimates depend on its own samples alone."""
        self._row = self._skipped_rows = min(self._recorded.run_ids_by_row, default=0)

    def read_block(self) -> RawBlock | None:
        """Return the next samples up to a gap or the beginning of a run; None at the end."""
        recorded, at = self._recorded, self._row
        if at >= len(recorded.ticks):
            return None
        self._run_id = recorded.run_ids_by_row.get(at, self._run_id)
        end = self._find_block_end(at)
        ticks = recorded.ticks[at:end]
        whole = int(np.argmax(ticks - ticks[0] != np.arange(len(ticks)))) or len(ticks)
        self._row = end = at + whole
        lost = int(ticks[0] - recorded.ticks[at - 1] - 1) if at > self._skipped_rows else 0
        if self._speed is not None:
            played = int(ticks[0]) + whole - int(recorded.ticks[self._skipped_rows])
            due = self._started_s + played / self._rate_hz / self._speed
            time.sleep(max(due - time.monotonic(), 0.0))
        return RawBlock(
            int(ticks[0]),
            time.monotonic_ns(),
            {name: values[at:end] for name, values in recorded.signals.items()},
            lost_samples=lost,
            limiter_flags=recorded.limiter_flags[at:end],
            limit_n=recorded.limit_n[at:end],
            run=self._run_id,
        )

    def _find_block_end(self, at: int) -> int:
        """Return the row behind the block that begins at this row; blocks end where steps do."""
        recorded = self._recorded
        end = min(at + self._block_samples, len(recorded.ticks))
        if end < len(recorded.ticks):
            end = max(end - int(recorded.ticks[end] + self.first_tick) % STEP_SAMPLES, at + 1)
        own = int(np.searchsorted(recorded.block_ends, at, "right"))
        stops = [*recorded.block_ends[own : own + 1].tolist(), *(row for row in recorded.run_ids_by_row if row > at)]
        return min([end, *stops])

    def write_command(self, command_v: float) -> AppliedCommand:
        """Ignore the command: a recording has no motor."""
        return AppliedCommand(0.0, 0, 0)


def read_log(path: Path, tool: Tool) -> SampleLog:
    """Read a recording by another program: a LabVIEW log, or a table as the tool file describes it.

    Raises:
        RecordingError: the file cannot be read, or does not fit the tool file.
    """
    is_table = (tool.table is not None or has_table_suffix(path.name)) and not starts_like_labview(path)
    return read_table_log(path, tool) if is_table else read_labview_log(path, tool)


def _complete_signals(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the columns of SENSOR_SIGNALS; one that was not recorded is NaN."""
    missing = np.full(len(columns["strain_v"]), np.nan)
    return {signal.name: columns.get(signal.name, missing) for signal in SENSOR_SIGNALS}


def read_recorded_tool(container: McapFile) -> Tool:
    """Return the tool that a file was recorded with.

    Raises:
        RecordingError: the file holds no tool, or one that this version cannot read.
    """
    try:
        return Tool.model_validate_json(container.attachments[TOOL_ATTACHMENT], extra="ignore")
    except (KeyError, ValidationError) as error:
        why = str(error).splitlines()[0]
        raise RecordingError(f"{container.path}: the tool it was recorded with cannot be read ({why}).") from None


def read_recorded_reference(container: McapFile) -> ReferenceGrasp | None:
    """Return the reference grasp that a recording follows; None without one.

    Raises:
        RecordingError: this version cannot read it.
    """
    content = container.attachments.get(REFERENCE_ATTACHMENT)
    try:
        return None if content is None else ReferenceGrasp.model_validate_json(content, extra="ignore")
    except ValidationError as error:
        why = str(error).splitlines()[0]
        raise RecordingError(
            f"{container.path}: its reference grasp cannot be read ({why}). {COPY_AGAIN_TEXT}"
        ) from None


def is_mcap(path: Path) -> bool:
    """Return whether the file begins with the MCAP magic bytes, or has the suffix `.mcap`."""
    try:
        with path.open("rb") as file:
            start = file.read(len(MAGIC))
    except OSError:
        start = b""
    return start == MAGIC or path.suffix.lower() == ".mcap"
