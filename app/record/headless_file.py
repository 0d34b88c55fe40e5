"""The recording of a run without a service: the same file, written by the process that also acquires and estimates."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from acquisition.blocks import SampleBlock
from acquisition.recordings import layout
from app.record.run_file import FLUSH_S, Rig, RunFile
from app.record.topics import GRASP, RUN, write
from app.wire import Grasp, GraspEnded, Run, RunState
from config.errors import RecordingError
from config.schema import Protocol
from estimator.blocks import EstimateBlock


class HeadlessFile:
    """A run's file, or none where no path is given."""

    def __init__(self, path: Path | None, rig: Rig, run_id: str, protocol: Protocol, cycles: int, tissue: str) -> None:
        self._path, self._rig, self._protocol = path, rig, protocol
        self._run = Run(
            id=run_id, protocol=protocol.name, cycles=cycles, tissue=tissue, by=None, state=RunState.RUNNING,
            started_at=datetime.now(UTC).isoformat(), ended_at=None, why=None, grasps=0,
        )  # fmt: skip
        self._file: RunFile | None = None
        self._flush_samples = int(FLUSH_S * rig.tool.board.sample_rate_hz)
        self._flush_at = 0

    def __enter__(self) -> Self:
        if self._path and (self._path.exists() or not self._path.parent.is_dir()):
            what = "exists already" if self._path.exists() else "cannot be made: its folder does not exist"
            raise RecordingError(f"{self._path}: {what}. Name another file with --record.")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file:
            with _told(self._path):
                self._file.close()

    def take(self, block: SampleBlock, estimate: EstimateBlock) -> None:
        """A block and its estimates."""
        if self._path is None:
            return
        with _told(self._path):
            file = self._file or self._open(self._path, block)
            file.add_samples(block)
            file.add_estimates(estimate.estimates, estimate.sequence, block.t_mono_ns)
            for record in estimate.ended:
                self._run = self._run.model_copy(update={"grasps": self._run.grasps + 1})
                grasp = Grasp(**asdict(record), alarms=[], held_back=False)
                file.tell(GRASP, write(GraspEnded(run_id=self._run.id, grasp=grasp)), time.time_ns())
            if file.samples >= self._flush_at:
                self._flush_at = file.samples + self._flush_samples
                file.flush()

    def _open(self, path: Path, block: SampleBlock) -> RunFile:
        offset_ns = time.time_ns() - block.t_mono_ns
        run, tick = self._run, str(int(block.samples["tick"][0]))
        about = {
            "run_id": run.id, "run_first_tick": tick, "first_tick": tick, "wall_offset_ns": str(offset_ns),
            "protocol": run.protocol, "cycles": str(run.cycles), "tissue": run.tissue or "", "by": "",
        }  # fmt: skip
        protocol = self._protocol.model_dump_json(indent=2).encode()
        self._file = RunFile(path, self._rig, about, {layout.PROTOCOL: protocol}, offset_ns)
        self._file.tell(RUN, write(run), time.time_ns())
        return self._file

    def run_ended(self, end: str, why: str) -> None:
        """The run is over."""
        self._run = self._run.model_copy(
            update={"state": RunState(end), "why": why, "ended_at": datetime.now(UTC).isoformat()}
        )
        if self._file:
            self._file.tell(RUN, write(self._run), time.time_ns())


@contextlib.contextmanager
def _told(path: Path | None) -> Iterator[None]:
    """What a disk says, as a person is told."""
    try:
        yield
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be written ({error.strerror}). Make room, or name another file with --record."
        ) from None
