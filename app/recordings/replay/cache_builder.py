"""The function that builds a replay cache, with the same conditioning, estimation and messages as for a live tool."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from pydantic import BaseModel

from acquisition.recordings.conditioned_blocks import read_conditioned_blocks
from acquisition.sample_block import SampleBlock
from app.messages.alarms import Alarm
from app.messages.grasps import Grasp, GraspEnded, Identification
from app.recordings.catalog import open_recording
from app.recordings.replay.replay_cache import COLUMNS_FILE, INDEX_FILE, MESSAGES_FILE, TOOL_FILE, MessageKind
from app.stream.alarms import AlarmManager
from app.stream.event_translator import EventTranslator
from app.stream.frames import build_channels, build_frame_columns
from config.errors import ServiceError
from config.schema import Settings, TissueLibrary, Tool, WarningSettings
from estimator.estimate_block import EstimateBlock, GraspRecord
from estimator.force_alarms import Priority

MESSAGE_INTERVAL_TICKS = 20  # shorter than a frame's; a live tool's blocks (5) take 1.5 times as long
PROGRESS_STEP = 0.01
RESERVED_DISK_SHARE = 0.5  # of the free disk, kept for recordings of a live tool


def build_replay_cache(
    send: Callable[[float], None], path: Path, tool: Tool, library: TissueLibrary, settings: Settings, folder: Path
) -> None:
    """Estimate a recording and write its replay cache into `folder`; send the share done.

    `tool`: for recordings that do not hold their tool.

    Raises:
        RecordingError: it cannot be read; the text names file and line.
        ServiceError: there is not enough room for the cache.
    """
    from estimator.online_estimator import TissueEstimator  # imports the compiler, which the server does not need

    recording = open_recording(path, tool)
    tool = recording.tool
    (folder / TOOL_FILE).write_text(tool.model_dump_json())
    columns = len(build_channels(list(library.tissues)))
    _check_disk_space(folder, 4 * columns * recording.sample_count)
    shown = 0.0

    def report_steps(share: float) -> None:
        nonlocal shown
        if share >= shown + PROGRESS_STEP:
            shown = share
            send(share)

    with (folder / COLUMNS_FILE).open("wb") as samples, (folder / MESSAGES_FILE).open("wb") as told:
        shape = recording.sample_count, columns
        np.lib.format.write_array_header_1_0(samples, {"descr": "<f4", "fortran_order": False, "shape": shape})
        cache = _ReplayCacheWriter(samples, told, tool, library, settings.warnings, recording.first_tick)
        session = TissueEstimator(tool, library, settings, recording.conditions)
        for whole in read_conditioned_blocks(recording, tool, settings.conditioning, report_steps):
            for block in _split_block(whole):
                cache.append(block, session.process(block))
        cache.finish(session.finish())
    cache.save_index(folder / INDEX_FILE)


def _check_disk_space(folder: Path, needed_bytes: int) -> None:
    free_bytes = shutil.disk_usage(folder).free
    if needed_bytes > (1.0 - RESERVED_DISK_SHARE) * free_bytes:
        raise ServiceError(
            f"To be replayed it needs {needed_bytes / 1e9:.1f} GB of disk for a while; {free_bytes / 1e9:.1f} GB are "
            "free, and half of that is kept for recordings. Make room, then open it again."
        )


def _split_block(block: SampleBlock) -> Iterator[SampleBlock]:
    """Split a block at multiples of MESSAGE_INTERVAL_TICKS, where the estimator steps in any case.

    Lost samples count for the first piece.
    """
    edges = np.flatnonzero(np.diff(block.samples["tick"] // MESSAGE_INTERVAL_TICKS)) + 1
    lost_samples = block.lost_samples
    for samples in np.split(block.samples, edges):
        yield replace(block, samples=samples, lost_samples=lost_samples)
        lost_samples = 0


class _ReplayCacheWriter:
    """Writer of a replay cache, block by block; it keeps only the index in memory."""

    def __init__(
        self,
        samples: BinaryIO,
        told: BinaryIO,
        tool: Tool,
        library: TissueLibrary,
        warnings: WarningSettings,
        first_tick: int,
    ) -> None:
        """`first_tick`: tick of the recording's first sample when it was made, which counts as 0 here."""
        self._first_tick = first_tick
        self._sample_file, self._message_file = samples, told
        self._rate_hz, self._tissues = tool.board.sample_rate_hz, len(library.tissues)
        self._alarms = AlarmManager(self._publish)
        dose_threshold_n_s = tool.to_displayed_n(warnings.spot_dose_n_s)
        self._translator = EventTranslator(
            library, self._rate_hz, dose_threshold_n_s, self._alarms, self._publish, self._publish_grasp
        )
        self._segments: list[tuple[int, int]] = []  # first tick and first row
        self._messages: list[tuple[int, int, int]] = []  # tick, kind, end
        self._alarm_ids: list[str] = []
        self._grasp_starts_s: list[float] = []
        self._tick, self._bytes, self.rows = 0, 0, 0
        self._last_estimate: EstimateBlock | None = None

    def append(self, block: SampleBlock, estimate: EstimateBlock) -> None:
        first_tick, self._tick = block.samples["tick"][[0, -1]].tolist()
        if block.lost_samples:
            text = f"{first_tick - self.rows} samples are missing from the recording so far"
            self._alarms.raise_technical("lost", Priority.LOW, text, self._time_ms())
        if block.lost_samples or not self._segments:
            self._segments.append((first_tick, self.rows))
        self._sample_file.write(build_frame_columns(block.samples, estimate.estimates, self._tissues).T.tobytes())
        self.rows += len(block.samples)
        self._translate(estimate)
        self._last_estimate = estimate

    def finish(self, cut_short: GraspRecord | None) -> None:
        """Write the grasp that the recording's end interrupted, if there is one."""
        if cut_short and self._last_estimate:
            self._translate(replace(self._last_estimate, ended=(cut_short,), alarms=(), withdrawn=()))

    def _translate(self, estimate: EstimateBlock) -> None:
        at_ms = self._time_ms()
        self._translator.process(estimate, at_ms, at_ms)

    def _time_ms(self) -> float:
        return 1e3 * self._tick / self._rate_hz

    def _publish_grasp(self, grasp: Grasp) -> None:
        self._grasp_starts_s.append(grasp.start_s)
        self._publish(GraspEnded(run_id=None, grasp=grasp))

    def _publish(self, message: BaseModel) -> None:
        kind, alarm_id = MessageKind.EVENT, ""
        match message:
            case Identification():
                kind = MessageKind.IDENTIFICATION
            case GraspEnded():
                kind = MessageKind.GRASP
            case Alarm():
                kind = MessageKind.ALARM if message.active or message.latched else MessageKind.ALARM_OVER
                alarm_id = f"replay-{message.id}"  # distinguishes it from the live tool's alarms
                message = message.model_copy(update={"id": alarm_id})
        self._bytes += self._message_file.write(message.model_dump_json().encode())
        self._messages.append((self._tick, kind, self._bytes))
        self._alarm_ids.append(alarm_id)

    def save_index(self, path: Path) -> None:
        ticks, kinds, ends = np.array(self._messages, np.int64).T
        first_ticks, first_rows = np.array(self._segments, np.int64).T
        np.savez(
            path,
            rate_hz=self._rate_hz,
            first_tick=self._first_tick,
            first_ticks=first_ticks,
            first_rows=first_rows,
            ticks=ticks,
            kinds=kinds,
            ends=ends,
            alarms=np.array(self._alarm_ids),
            grasp_starts_s=np.array(self._grasp_starts_s, float),
        )
