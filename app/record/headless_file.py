"""The recording of a run without a service: the same file, written by the process that also acquires and estimates."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from pydantic import BaseModel

from acquisition.blocks import SampleBlock
from acquisition.recordings import layout
from app.alarms import AlarmBook
from app.record.run_file import Rig, RunFile
from app.record.topics import RUN, topic_of, write
from app.teller import Teller
from app.wire import AlarmKind, Grasp, GraspEnded, Run, RunState
from config.errors import RecordingError
from config.schema import Protocol
from estimator.blocks import EstimateBlock, GraspRecord

FLUSH_SAMPLES = 1_000
ENDING = ".mcap"


def new_run(run_id: str, protocol: str, cycles: int, tissue: str | None) -> Run:
    """A run that begins now."""
    return Run(
        id=run_id,
        protocol=protocol,
        cycles=cycles,
        tissue=tissue,
        by=None,
        state=RunState.RUNNING,
        started_at=datetime.now(UTC).isoformat(),
        ended_at=None,
        why=None,
        grasps=0,
    )


class HeadlessFile:
    """Writes what is taken, and what a viewer would have been told of it. Entered once, before the first block.

    The times in it are those of the sample clock, counted from `started_ns`.
    """

    def __init__(
        self,
        path: Path,
        rig: Rig,
        run: Run,
        protocol: Protocol | None = None,
        *,
        started_ns: int | None = None,
        about: dict[str, str] | None = None,
        can_be_repeated: bool = False,
    ) -> None:
        """`started_ns`: of the first sample, ns since 1970; None: now. `about`: what else is to be known.

        With `can_be_repeated`, an error leaves no file behind.
        """
        self._path, self._rig, self.run, self._protocol = path, rig, run, protocol
        self._started_ns = time.time_ns() if started_ns is None else started_ns
        self._about, self._can_be_repeated = about or {}, can_be_repeated
        self._step_ns = 1e9 / rig.tool.board.sample_rate_hz
        self._first_tick = self._now_ns = 0
        self._file: RunFile | None = None
        self._flush_at = FLUSH_SAMPLES
        self._last: EstimateBlock | None = None
        self._alarms = AlarmBook(self._tell)
        self._teller = Teller(rig.library, rig.tool.board.sample_rate_hz, self._alarms, self._tell, self._tell_grasp)

    def __enter__(self) -> Self:
        if self._path.suffix != ENDING:
            raise RecordingError(f"{self._path}: the name of a recording ends with {ENDING}.")
        if self._path.exists():
            raise RecordingError(f"{self._path}: exists already, and is kept. Name another file.")
        if not self._path.parent.is_dir():
            raise RecordingError(f"{self._path}: cannot be made, its folder does not exist. Make it first.")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        file, self._file = self._file, None
        if file is None:
            return
        if error and self._can_be_repeated:
            file.abandon()
            self._path.unlink(missing_ok=True)
        elif isinstance(error, RecordingError):  # there is no room: what was written before can be read
            file.abandon()
        else:
            with self._writing():
                file.close()

    def take(self, block: SampleBlock, estimate: EstimateBlock) -> None:
        """A block and its estimates.

        Raises:
            RecordingError: the disk is full or gone.
        """
        if self._file is None:
            self._first_tick = int(block.samples["tick"][0])
        self._now_ns = round((int(block.samples["tick"][-1]) + 1 - self._first_tick) * self._step_ns)
        with self._writing():
            file = self._file = self._file or self._open()
            file.add_samples(replace(block, t_mono_ns=self._now_ns))
            file.add_estimates(estimate.estimates, estimate.sequence, self._now_ns)
            self._hear(estimate)
            if file.samples >= self._flush_at:
                self._flush_at = file.samples + FLUSH_SAMPLES
                file.flush(sync=False)

    def _hear(self, estimate: EstimateBlock) -> None:
        self._last = estimate
        at_ms = (self._started_ns + self._now_ns) / 1e6
        self._teller.take(estimate, at_ms, at_ms)

    def let_go(self, text: str) -> None:
        """The limiter let the grasp go."""
        with self._writing():
            self._alarms.happened("let-go", AlarmKind.FORCE, text, (self._started_ns + self._now_ns) / 1e6)

    def cut_short(self, grasp: GraspRecord | None) -> None:
        """The grasp that the end cut short, if there is one."""
        if grasp and self._last:
            with self._writing():
                self._hear(replace(self._last, ended=(grasp,), alarms=(), withdrawn=()))

    def run_ended(self, state: RunState, why: str) -> None:
        """The run is over."""
        self.run = self.run.model_copy(update={"state": state, "why": why, "ended_at": datetime.now(UTC).isoformat()})
        with self._writing():
            self._write(RUN, self.run)

    def _open(self) -> RunFile:
        run, tick = self.run, str(self._first_tick)
        about = {
            "run_id": run.id,
            "run_first_tick": tick,
            "first_tick": tick,
            "wall_offset_ns": str(self._started_ns),
            "protocol": run.protocol,
            "tissue": run.tissue or "",
            "by": "",
            **self._about,
        }
        attached = {layout.PROTOCOL: self._protocol.model_dump_json(indent=2).encode()} if self._protocol else {}
        self._file = RunFile(self._path, self._rig, about, attached, self._started_ns)
        self._write(RUN, run)
        return self._file

    def _tell_grasp(self, grasp: Grasp) -> None:
        self.run = self.run.model_copy(update={"grasps": self.run.grasps + 1})
        self._tell(GraspEnded(run_id=self.run.id, grasp=grasp.model_copy(update={"index": self.run.grasps})))

    def _tell(self, message: BaseModel) -> None:
        topic = topic_of(message)
        if topic:
            self._write(topic, message)

    def _write(self, topic: str, message: BaseModel) -> None:
        if self._file:
            self._file.tell(topic, write(message), self._started_ns + self._now_ns)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """What a disk says, as a person is told."""
        try:
            yield
        except OSError as error:
            raise RecordingError(
                f"{self._path}: cannot be written ({error.strerror}). Make room, or name another file."
            ) from None
