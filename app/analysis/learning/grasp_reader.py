"""Reads labeled recordings for `graspwatch learn`, grasp by grasp."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from acquisition.recordings.conditioned_blocks import read_conditioned_blocks
from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import RecordingSource, is_mcap
from acquisition.sample_block import SAMPLE_DTYPE, SampleFlag
from config.errors import RecordingError
from config.schema import Settings, TissueLibrary, Tool
from estimator.learning.parameter_fit import fit_parameters, measure_thickness_m
from estimator.learning.recorded_grasps import LabeledRecording, RecordedGrasp

IN_GRASP = SampleFlag.IN_GRASP.value
Progress = Callable[[float], None]


def recording_sha256(path: Path) -> str:
    """Return the hexadecimal SHA-256 of a file's content; of an imported recording, that of the file it came from.

    Raises:
        RecordingError: the file is missing or cannot be read.
    """
    if is_mcap(path) and (imported := McapFile(path).metadata.get("imported_sha256")):
        return imported
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except FileNotFoundError:
        raise RecordingError(f"{path}: there is no such file. Check the path.") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}).") from None


def find_learned_files(library: TissueLibrary, files: Sequence[Path]) -> list[str]:
    """Return the names of those files that the library was learned from, by their content.

    Raises:
        RecordingError: a file is missing or cannot be read.
    """
    learned = {r.sha256 for t in library.tissues.values() if t.learned for r in t.learned.recordings}
    return [path.name for path in files if recording_sha256(path) in learned] if learned else []


def read_grasps(
    label: str, path: Path, tool: Tool, settings: Settings, guess: np.ndarray, progress: Progress
) -> LabeledRecording:
    """Read a recording's grasps, and fit the parameters of each from `guess` (log alpha, log beta, log d).

    Raises:
        RecordingError: the file cannot be read; the text names file and line.
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
    """Read a whole recording, calibrated and segmented, as (n,) of `SAMPLE_DTYPE`."""
    recording = RecordingSource(path, tool)
    if recording.tool.calibration_fingerprint != tool.calibration_fingerprint:
        raise RecordingError(
            f"{path}: was recorded with the tool {recording.tool.name!r} as it was calibrated then, the others with "
            f"{tool.name!r}. A library is learned from recordings of one tool: leave this one out, or learn it apart."
        )
    recording.skip_to_run()
    blocks = read_conditioned_blocks(recording, tool, settings.conditioning, progress)
    return np.concatenate([np.zeros(0, SAMPLE_DTYPE), *(block.samples for block in blocks)])
