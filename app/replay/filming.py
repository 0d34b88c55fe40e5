"""Makes a recording's film: the same pipeline, estimation and words as of a live tool, written instead of sent."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from pydantic import BaseModel

from acquisition.blocks import SampleBlock
from acquisition.pipeline import Pipeline
from app.alarms import AlarmBook
from app.frames import channels, columns_of
from app.replay.film import COLUMNS, INDEX, TOLD, TOOL, Kind
from app.replay.shelf import open_recording
from app.teller import Teller
from app.wire import Alarm, Grasp, GraspEnded, Identification, Priority
from config.errors import ServiceError
from config.schema import Settings, TissueLibrary, Tool
from estimator.blocks import EstimateBlock, GraspRecord

TOLD_EVERY = 20  # ticks: finer than a frame; as fine as a live tool's blocks (5) takes half as long again
PROGRESS_STEP = 0.01
ROOM_LEFT = 0.5  # of the free disk: a live tool's recordings need it more


def make_film(
    tell: Callable[[float], None], path: Path, tool: Tool, library: TissueLibrary, settings: Settings, folder: Path
) -> None:
    """Estimate a recording and write its film into `folder`; tells the share done.

    `tool`: of recordings that do not say with which they were made.

    Raises:
        RecordingError: it cannot be read; names file and line.
        ServiceError: there is not enough room for the film.
    """
    from estimator.session import EstimationSession  # with the compiler, which the server does not need

    recording = open_recording(path, tool)
    tool = recording.tool
    (folder / TOOL).write_text(tool.model_dump_json())
    columns = len(channels(list(library.tissues)))
    _check_room(folder, 4 * columns * recording.samples)
    shown = 0.0
    with recording, (folder / COLUMNS).open("wb") as samples, (folder / TOLD).open("wb") as told:
        shape = recording.samples, columns
        np.lib.format.write_array_header_1_0(samples, {"descr": "<f4", "fortran_order": False, "shape": shape})
        film = _Writer(samples, told, tool, library)
        pipeline, session = Pipeline(tool, settings.conditioning), EstimationSession(tool, library, settings)
        while (raw := recording.read_block()) is not None:
            for block in _cut(pipeline.process(raw)):
                film.take(block, session.process(block))
            if film.rows >= (shown + PROGRESS_STEP) * recording.samples:
                shown = film.rows / recording.samples
                tell(shown)
        film.end(session.finish())
    film.save_index(folder / INDEX)


def _check_room(folder: Path, wanted_bytes: int) -> None:
    free_bytes = shutil.disk_usage(folder).free
    if wanted_bytes > (1.0 - ROOM_LEFT) * free_bytes:
        raise ServiceError(
            f"To be replayed it needs {wanted_bytes / 1e9:.1f} GB of disk for a while; {free_bytes / 1e9:.1f} GB are "
            "free, and half of that is kept for recordings. Make room, then open it again."
        )


def _cut(block: SampleBlock) -> Iterator[SampleBlock]:
    """Pieces of a block, so that what changes is told in time; cut where the estimator steps in any case.

    What was lost was lost before the first.
    """
    edges = np.flatnonzero(np.diff(block.samples["tick"] // TOLD_EVERY)) + 1
    lost_samples = block.lost_samples
    for samples in np.split(block.samples, edges):
        yield replace(block, samples=samples, lost_samples=lost_samples)
        lost_samples = 0


class _Writer:
    """Writes a film block by block; in memory it keeps only where everything is."""

    def __init__(self, samples: BinaryIO, told: BinaryIO, tool: Tool, library: TissueLibrary) -> None:
        self._samples, self._told = samples, told
        self._rate_hz, self._tissues = tool.board.sample_rate_hz, len(library.tissues)
        self._alarms = AlarmBook(self._tell)
        self._teller = Teller(library, self._rate_hz, self._alarms, self._tell, self._tell_grasp)
        self._pieces: list[tuple[int, int]] = []  # first tick and first row
        self._messages: list[tuple[int, int, int]] = []  # tick, kind, end
        self._alarm_ids: list[str] = []
        self._grasp_starts_s: list[float] = []
        self._tick, self._bytes, self.rows = 0, 0, 0
        self._last: EstimateBlock | None = None

    def take(self, block: SampleBlock, estimate: EstimateBlock) -> None:
        first_tick, self._tick = block.samples["tick"][[0, -1]].tolist()
        if block.lost_samples:
            text = f"{first_tick - self.rows} samples are missing from the recording so far"
            self._alarms.raise_technical("lost", Priority.LOW, text, self._at_ms())
        if block.lost_samples or not self._pieces:
            self._pieces.append((first_tick, self.rows))
        self._samples.write(columns_of(block.samples, estimate.estimates, self._tissues).T.tobytes())
        self.rows += len(block.samples)
        self._take(estimate)
        self._last = estimate

    def end(self, cut_short: GraspRecord | None) -> None:
        """The recording's end, with the grasp that it cut short."""
        if cut_short and self._last:
            self._take(replace(self._last, ended=(cut_short,), alarms=(), withdrawn=()))

    def _take(self, estimate: EstimateBlock) -> None:
        at_ms = self._at_ms()
        self._teller.take(estimate, at_ms, at_ms)

    def _at_ms(self) -> float:
        return 1e3 * self._tick / self._rate_hz

    def _tell_grasp(self, grasp: Grasp) -> None:
        self._grasp_starts_s.append(grasp.start_s)
        self._tell(GraspEnded(run_id=None, grasp=grasp))

    def _tell(self, message: BaseModel) -> None:
        kind, alarm_id = Kind.EVENT, ""
        match message:
            case Identification():
                kind = Kind.IDENTIFICATION
            case GraspEnded():
                kind = Kind.GRASP
            case Alarm():
                kind = Kind.ALARM if message.active or message.latched else Kind.ALARM_OVER
                alarm_id = f"replay-{message.id}"  # never to be taken for one of the live tool
                message = message.model_copy(update={"id": alarm_id})
        self._bytes += self._told.write(message.model_dump_json().encode())
        self._messages.append((self._tick, kind, self._bytes))
        self._alarm_ids.append(alarm_id)

    def save_index(self, path: Path) -> None:
        ticks, kinds, ends = np.array(self._messages, np.int64).T
        first_ticks, first_rows = np.array(self._pieces, np.int64).T
        np.savez(
            path,
            rate_hz=self._rate_hz,
            first_ticks=first_ticks,
            first_rows=first_rows,
            ticks=ticks,
            kinds=kinds,
            ends=ends,
            alarms=np.array(self._alarm_ids),
            grasp_starts_s=np.array(self._grasp_starts_s, float),
        )
