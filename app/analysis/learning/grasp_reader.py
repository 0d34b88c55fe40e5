"""Labelled recordings, grasp by grasp: the one place where `graspwatch learn` reads them."""

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import RecordingSource, is_mcap
from acquisition.sample_block import SAMPLE_DTYPE, SampleFlag
from acquisition.signals.pipeline import ConditioningPipeline
from config.errors import RecordingError
from config.schema import Settings, Tool
from estimator.learning.parameter_fit import fit_parameters, measure_thickness_m
from estimator.learning.recorded_grasps import LabeledRecording, RecordedGrasp

IN_GRASP = SampleFlag.IN_GRASP.value
Progress = Callable[[float], None]


def recording_sha256(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal; of an imported one, of the file that it was imported from.

    Raises:
        RecordingError: it is missing or cannot be read.
    """
    if is_mcap(path) and (imported := McapFile(path).metadata.get("imported_sha256")):
        return imported
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except FileNotFoundError:
        raise RecordingError(f"{path}: there is no such file. Check the path.") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}).") from None


def read_grasps(
    label: str, path: Path, tool: Tool, settings: Settings, guess: np.ndarray, progress: Progress
) -> LabeledRecording:
    """A recording's grasps, each with its parameters, searched from `guess` (log alpha, log beta, log d).

    Raises:
        RecordingError: the file cannot be read; names file and line.
    """
    sha256 = recording_sha256(path)
    samples = _read_samples(path, tool, settings, progress)
    rate_hz = tool.board.sample_rate_hz
    grasps = []
    for index in range(1, int(samples["grasp"].max(initial=0)) + 1):
        own = samples[(samples["grasp"] == index) & ((samples["flags"] & IN_GRASP) != 0)]
        grasps.append(RecordedGrasp(index, own, fit_parameters(own, rate_hz, guess), measure_thickness_m(own, tool)))
    return LabeledRecording(label, path.name, sha256, tuple(grasps))


def _read_samples(path: Path, tool: Tool, settings: Settings, progress: Progress) -> np.ndarray:
    """A whole recording, calibrated and segmented, dtype SAMPLE."""
    recording = RecordingSource(path, tool)
    if recording.tool.calibration_fingerprint != tool.calibration_fingerprint:
        raise RecordingError(
            f"{path}: was recorded with the tool {recording.tool.name!r} as it was calibrated then, the others with "
            f"{tool.name!r}. A library is learned from recordings of one tool: leave this one out, or learn it apart."
        )
    recording.skip_to_run()
    pipeline, blocks, done = ConditioningPipeline(tool, settings.conditioning), [np.zeros(0, SAMPLE_DTYPE)], 0
    with recording:
        while (raw := recording.read_block()) is not None:
            blocks.append(pipeline.process(raw).samples)
            done += len(raw)
            progress(done / recording.sample_count)
    return np.concatenate(blocks)
