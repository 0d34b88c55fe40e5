"""The class HeadlessRecorder: records a run without a service, in the process that also acquires and estimates."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from pydantic import BaseModel

from acquisition.recordings import mcap_layout
from acquisition.recordings.file_names import check_run_name
from acquisition.sample_block import SampleBlock
from app.messages.alarms import AlarmKind
from app.messages.grasps import Grasp, GraspEnded
from app.messages.lab_sessions import LabSession
from app.messages.runs import Run, RunState
from app.recordings.mcap_writer import RECORDING_SUFFIX, McapRunWriter, RecordingContext
from app.recordings.topics import RUN_TOPIC, encode_message, find_topic
from app.stream.alarms import AlarmManager
from app.stream.event_translator import EventTranslator
from config.errors import RecordingError, ServiceError, build_write_error
from config.schema import GraspProtocol
from estimator.estimate_block import EstimateBlock, GraspRecord, SpotVerdict
from estimator.estimate_messages import PublishedEstimates

FLUSH_SAMPLES = 1_000


def create_run(run_id: str, protocol: str, cycles: int, tissue: str | None) -> Run:
    """Return the record of a run that begins now; nothing is started."""
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


class HeadlessRecorder:
    """Recorder of samples, estimates and the messages that viewers would receive.

    It is entered once, before the first block. Its times are those of the sample clock, counted from `started_ns`.
    """

    def __init__(
        self,
        path: Path,
        recording_context: RecordingContext,
        run: Run,
        protocol: GraspProtocol | None = None,
        *,
        started_ns: int | None = None,
        metadata: dict[str, str] | None = None,
        lab_session: LabSession | None = None,
        discard_on_error: bool = False,
    ) -> None:
        """`started_ns`: time of the first sample, ns since 1970; None: now. `metadata`: added to the file's.

        `lab_session`: the laboratory session that the run belongs to.

        With `discard_on_error`, an error leaves no file behind.
        """
        self._path, self._recording_context, self.run, self._protocol = path, recording_context, run, protocol
        self._started_ns = time.time_ns() if started_ns is None else started_ns
        self._metadata, self._discard_on_error = metadata or {}, discard_on_error
        self._lab_session = lab_session
        self._sample_period_ns = 1e9 / recording_context.tool.board.sample_rate_hz
        self._first_tick = self._now_ns = 0
        self._file: McapRunWriter | None = None
        self._next_flush_samples = FLUSH_SAMPLES
        self._last_estimate: EstimateBlock | None = None
        self._alarms = AlarmManager(self._publish)
        self._translator = EventTranslator(
            recording_context.library,
            recording_context.tool.board.sample_rate_hz,
            recording_context.tool.to_displayed_n(recording_context.settings.warnings.spot_dose_n_s),
            self._alarms,
            self._publish,
            self._publish_grasp,
        )

    def __enter__(self) -> Self:
        if self._path.suffix != RECORDING_SUFFIX:
            raise RecordingError(f"{self._path}: the name of a recording ends with {RECORDING_SUFFIX}.")
        check_run_name(self._path.stem, "Name the file otherwise.")
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
        if error and self._discard_on_error:
            file.abandon()
            self._path.unlink(missing_ok=True)
        elif isinstance(error, RecordingError | ServiceError):  # no room: the part already written is readable
            file.abandon()
        else:
            with self._explain_disk_errors():
                file.close()

    def append(self, block: SampleBlock, estimate: EstimateBlock) -> None:
        """Write a block and its estimates.

        Raises:
            ServiceError: the disk is full.
            RecordingError: the disk is gone.
        """
        if self._file is None:
            self._first_tick = int(block.samples["tick"][0])
        self._now_ns = round((int(block.samples["tick"][-1]) + 1 - self._first_tick) * self._sample_period_ns)
        with self._explain_disk_errors():
            file = self._file = self._file or self._open_file()
            file.add_samples(replace(block, t_mono_ns=self._now_ns))
            file.add_estimates(PublishedEstimates(estimate.sequence, self._now_ns, estimate.estimates))
            self._translate(estimate)
            if file.samples >= self._next_flush_samples:
                self._next_flush_samples = file.samples + FLUSH_SAMPLES
                file.flush(sync=False)

    def _translate(self, estimate: EstimateBlock) -> None:
        self._last_estimate = estimate
        at_ms = (self._started_ns + self._now_ns) / 1e6
        self._translator.process(estimate, at_ms, at_ms)

    def add_release_alarm(self, text: str) -> None:
        """Record that the limiter released the grasp."""
        with self._explain_disk_errors():
            self._alarms.raise_latched("let-go", AlarmKind.FORCE, text, (self._started_ns + self._now_ns) / 1e6)

    def add_interrupted_grasp(self, grasp: GraspRecord | None, spots: tuple[SpotVerdict, ...] = ()) -> None:
        """Record the grasp that the run's end interrupted, if there is one, and the `spots` with it."""
        if grasp and (last := self._last_estimate):
            answer = last.identification.model_copy(update={"spots": spots})
            with self._explain_disk_errors():
                self._translate(replace(last, identification=answer, ended=(grasp,), alarms=(), withdrawn=()))

    def end_run(self, state: RunState, why: str, ended_at: str | None = None) -> None:
        """Record the end of the run; `ended_at`, ISO 8601, is now by default."""
        ended_at = ended_at or datetime.now(UTC).isoformat()
        self.run = self.run.model_copy(update={"state": state, "why": why, "ended_at": ended_at})
        with self._explain_disk_errors():
            self._write_message(RUN_TOPIC, self.run)

    def _open_file(self) -> McapRunWriter:
        run, tick = self.run, str(self._first_tick)
        about = {
            "run_id": run.id,
            "run_first_tick": tick,
            "first_tick": tick,
            "wall_offset_ns": str(self._started_ns),
            "protocol": run.protocol,
            "tissue": run.tissue or "",
            "by": "",
            **self._metadata,
        }
        named = {mcap_layout.PROTOCOL_ATTACHMENT: self._protocol, mcap_layout.SESSION_ATTACHMENT: self._lab_session}
        attached = {name: each.model_dump_json(indent=2).encode() for name, each in named.items() if each}
        self._file = McapRunWriter(self._path, self._recording_context, about, attached, self._started_ns)
        self._write_message(RUN_TOPIC, run)
        return self._file

    def _publish_grasp(self, grasp: Grasp) -> None:
        self.run = self.run.model_copy(update={"grasps": self.run.grasps + 1})
        self._publish(GraspEnded(run_id=self.run.id, grasp=grasp.model_copy(update={"index": self.run.grasps})))

    def _publish(self, message: BaseModel) -> None:
        topic = find_topic(message)
        if topic:
            self._write_message(topic, message)

    def _write_message(self, topic: str, message: BaseModel) -> None:
        if self._file:
            self._file.add_message(topic, encode_message(message), self._started_ns + self._now_ns)

    @contextlib.contextmanager
    def _explain_disk_errors(self) -> Iterator[None]:
        """Convert disk errors to a RecordingError, or on a full disk a ServiceError, with a text for the user."""
        try:
            yield
        except OSError as error:
            text = f"{self._path}: cannot be written ({error.strerror}). Make room, or name another file."
            raise build_write_error(text, error, RecordingError) from None
