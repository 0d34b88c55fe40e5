"""Decides what goes into which file: a run with what came right before and after it."""

import contextlib
import time
from collections import deque
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from acquisition.blocks import SampleBlock
from acquisition.recordings import layout
from app.disk import free_bytes
from app.record.run_file import FLUSH_S, Rig, RunFile
from app.record.topics import RUN, read, write
from app.wire import Run, RunState
from config.schema import Protocol

ENDING = ".mcap"
PATIENCE_S = 10.0  # and so long a server that hangs may take to tell what came of the run
GRACE_S = 0.2  # estimates come after their samples, a run's last words after its last sample
DEMONSTRATION = "demo-"  # begins the id of a demonstration's run


class RecordingStoppedError(Exception):
    """A recording ended before its run; the text says why, and what to do."""


@dataclass(frozen=True, slots=True)
class Brief:
    """What is known of a run before it begins. `protocol` is its JSON."""

    run_id: str
    protocol: str
    cycles: int
    tissue: str | None
    by: str | None


@dataclass(frozen=True, slots=True)
class Estimated:
    """Estimates of one block of samples."""

    sequence: int
    published_ns: int
    estimates: np.ndarray


class Recorder:
    """Give it everything that happens, in its order; it writes a file for each run.

    Every method but `brief` may raise RecordingStoppedError: that file is closed, later runs are recorded again.
    """

    def __init__(self, folder: Path, rig: Rig) -> None:
        self._folder, self._rig = folder, rig
        rate_hz = rig.tool.board.sample_rate_hz
        self._settings = rig.settings.recording
        self._before = int(self._settings.before_s * rate_hz)
        self._after = int(self._settings.after_s * rate_hz)
        self._grace, self._patience = int(GRACE_S * rate_hz), int(PATIENCE_S * rate_hz)
        self._last_sequence = 0  # of the block written last
        self._blocks: deque[SampleBlock] = deque()
        self._estimates: deque[Estimated] = deque()
        self._early: deque[Estimated] = deque()  # those of blocks that are still to come
        self._brief: Brief | None = None
        self._told: list[tuple[str, bytes, int]] = []  # since then, until the run begins
        self._wall_offset_ns = time.time_ns() - time.monotonic_ns()
        self._run = ""
        self._until: int | None = None  # tick; None while the run goes on
        self._told_run: Run | None = None  # as the server told it last
        self._end: Run | None = None  # the same with its end, as the acquisition told it
        self._flushed_s = 0.0
        self.file: RunFile | None = None
        self.finished: list[Path] = []  # since somebody took them

    def brief(self, brief: Brief) -> None:
        """A run is about to begin."""
        self._brief = brief
        self._told = []

    def take_samples(self, block: SampleBlock) -> None:
        """A block of samples, and with it the time."""
        if self._blocks and block.sequence <= self._blocks[-1].sequence:  # the acquisition was restarted
            self.end("the acquisition worker was restarted")
            self._blocks.clear()
            self._estimates.clear()
        begins, self._run = block.run not in ("", self._run), block.run or self._run
        tick = int(block.samples["tick"][0])
        try:
            if begins:
                self.end("the next run began")
                self._begin(block)
            elif self.file and not block.run and self._until is None:
                self._until = tick + self._after
            if self.file and self._until is not None and tick >= self._until + self._waits:
                self.end()
            if self.file and (self._until is None or tick < self._until):
                self.file.add_samples(block)
                self._last_sequence = block.sequence
                while self._early and self._early[0].sequence <= block.sequence:
                    self._add(self._early.popleft())
        finally:
            self._keep(block)
        self._flush_in_time()

    def take_estimates(self, estimated: Estimated) -> None:
        """The estimates of a block, which mostly came before; where much waits, the two come in any order."""
        self._estimates.append(estimated)
        if self.file and estimated.sequence <= self._last_sequence:
            self._add(estimated)
        elif self.file:
            self._early.append(estimated)

    def _add(self, estimated: Estimated) -> None:
        assert self.file is not None
        self.file.add_estimates(estimated.estimates, estimated.sequence, estimated.published_ns)

    def tell(self, topic: str, content: bytes) -> None:
        """A message of `app/record/topics.py`."""
        at_ns = time.monotonic_ns() + self._wall_offset_ns
        if topic == RUN:
            self._told_run = Run.model_validate(read(topic, content))
        if self.file:
            self.file.tell(topic, content, at_ns)
        if self._brief and self._brief.run_id != self._run:
            self._told.append((topic, content, at_ns))

    def run_ended(self, run_id: str, end: RunState, why: str) -> None:
        """The acquisition's own words of a run's end, which count where the server hangs and does not tell it."""
        if self._told_run and self._told_run.id == run_id:
            update = {"state": end, "why": why, "ended_at": datetime.now(UTC).isoformat()}
            self._end = self._told_run.model_copy(update=update)

    @property
    def _untold(self) -> Run | None:
        """A run's end that the server has not told yet."""
        told, end = self._told_run, self._end
        return end if told and end and told.id == end.id and told.state is RunState.RUNNING else None

    @property
    def _waits(self) -> int:
        """Samples after the last one of a file, for what is still to be told."""
        return self._patience if self._untold else self._grace

    def end(self, why: str = "") -> None:
        """Make the file whole, if one is being written."""
        if self.file is None:
            return
        if untold := self._untold:
            self.tell(RUN, write(untold))
        file, self.file, self._until = self.file, None, None
        self._early.clear()
        self.finished.append(file.path)
        try:
            file.close(why=why) if why else file.close()
        except OSError as error:
            raise self._stopped(file.path, error) from None
        if file.path.name.startswith(DEMONSTRATION):
            with contextlib.suppress(OSError):  # somebody else tidies up, too, or nobody may
                self._drop_old_demonstrations()

    def _begin(self, block: SampleBlock) -> None:
        """A file for the run that begins with this block, with what came right before it."""
        self._until = None
        if not self._settings.enabled:
            return
        free = free_bytes(self._folder)
        least = self._settings.least_free_bytes
        if free is None or free < least:
            raise RecordingStoppedError(
                f"Run {block.run} is not recorded: the disk of {self._folder} has fewer than {least / 1e6:.0f} MB "
                "free. Make room."
            )
        known = self._brief if self._brief and self._brief.run_id == block.run else None
        first = self._blocks[0] if self._blocks else block
        about = {
            "run_id": block.run,
            "run_first_tick": str(int(block.samples["tick"][0])),
            "first_tick": str(int(first.samples["tick"][0])),
            "wall_offset_ns": str(self._wall_offset_ns),
        }
        attachments = {}
        if known:
            about |= {"cycles": str(known.cycles), "tissue": known.tissue or "", "by": known.by or ""}
            about["protocol"] = Protocol.model_validate_json(known.protocol).name
            attachments[layout.PROTOCOL] = known.protocol.encode()
        path = self._free_name(block.run)
        if path.stem != block.run:
            about["continues"] = block.run
        try:
            self.file = RunFile(path, self._rig, about, attachments, self._wall_offset_ns)
        except OSError as error:
            raise self._stopped(path, error) from None
        for before in self._blocks:
            self.file.add_samples(before)
            self._last_sequence = before.sequence
        for told in self._told:
            self.file.tell(*told)
        self._told = []
        for estimated in self._estimates:
            self._add(estimated)

    def _free_name(self, run_id: str) -> Path:
        """A run whose file exists was cut off by this recorder's predecessor: it goes on in the next one."""
        names = (f"{run_id}{part}{ENDING}" for part in ("", *(f"-part{n}" for n in range(2, 1000))))
        return next(path for name in names if not (path := self._folder / name).exists())

    def _keep(self, block: SampleBlock) -> None:
        """Remember the last seconds."""
        self._blocks.append(block)
        oldest = int(block.samples["tick"][-1]) - self._before
        while self._blocks and int(self._blocks[0].samples["tick"][0]) <= oldest:
            self._blocks.popleft()
        first = self._blocks[0].sequence if self._blocks else block.sequence + 1
        while self._estimates and self._estimates[0].sequence < first:
            self._estimates.popleft()

    def _flush_in_time(self) -> None:
        if self.file is None or time.monotonic() - self._flushed_s < FLUSH_S:
            return
        self._flushed_s = time.monotonic()
        path = self.file.path
        try:
            self.file.flush()
            free = free_bytes(self._folder)
        except OSError as error:
            file, self.file = self.file, None
            file.abandon()
            self.finished.append(path)
            raise self._stopped(path, error) from None
        if free is not None and free < self._settings.least_free_bytes:
            self.end("the disk is nearly full")
            raise RecordingStoppedError(
                f"The recording {path.name} was ended, the run goes on: the disk of {self._folder} has fewer than "
                f"{self._settings.least_free_bytes / 1e6:.0f} MB free. Make room."
            )

    def _stopped(self, path: Path, error: OSError) -> RecordingStoppedError:
        return RecordingStoppedError(
            f"The recording {path.name} stopped ({error.strerror}), the run goes on: what was written before can be "
            f"read. Mend the disk of {self._folder}, or make room."
        )

    def _drop_old_demonstrations(self) -> None:
        """Nobody asked for them, and a demonstration goes on all day."""
        shown = sorted(self._folder.glob(f"{DEMONSTRATION}*{ENDING}"), key=lambda path: path.stat().st_mtime_ns)
        for path in shown[: max(len(shown) - self._settings.demonstrations_kept, 0)]:
            path.unlink(missing_ok=True)
