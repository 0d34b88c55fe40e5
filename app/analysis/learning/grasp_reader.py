"""Functions that read labeled recordings for `graspwatch learn`, grasp by grasp."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from acquisition.recordings.conditioned_blocks import read_conditioned_blocks
from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import RecordingSource, is_mcap
from acquisition.sample_block import SAMPLE_DTYPE
from config.errors import CalibrationError, ConfigurationError, RecordingError
from config.schema import ReferenceGrasp, Settings, TissueLibrary, Tool, is_same_day
from estimator.learning.parameter_fit import fit_parameters, measure_thickness_m
from estimator.learning.recorded_grasps import LabeledRecording, RecordedGrasp, split_grasps
from estimator.learning.reference_measurement import measure_reference

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
    """Return a recording's grasps, the parameters of each fitted from `guess` (log alpha, log beta, log d).

    Raises:
        RecordingError: the file cannot be read; the text names file and line.
    """
    sha256 = recording_sha256(path)
    recording = open_recording(path, tool)
    if recording.is_reference_grasp:
        raise RecordingError(
            f"{path}: is a reference grasp on empty jaws, and holds no tissue. Leave its label out, or name it with "
            "--reference."
        )
    rate_hz = tool.board.sample_rate_hz
    grasps = tuple(
        RecordedGrasp(index, own, fit_parameters(own, rate_hz, guess), measure_thickness_m(own, tool))
        for index, own in split_grasps(_read_samples(recording, tool, settings, progress))
    )
    return LabeledRecording(label, path.name, sha256, grasps, recording.conditions)


def read_reference(path: Path, tool: Tool, settings: Settings) -> ReferenceGrasp:
    """Measure the reference grasp in a recording on empty jaws.

    Raises:
        RecordingError: the file cannot be read, or does not say when it was recorded.
        CalibrationError: it is no reference grasp; the text says why.
    """
    recording = open_recording(path, tool)
    taken_at = recording.conditions.recorded_at
    if taken_at is None:
        raise RecordingError(
            f"{path}: does not say when it was recorded, so it is a reference for no day. Add Date and Time in a copy."
        )
    person = recording.mcap_file.metadata.get("by") if recording.mcap_file else None
    try:
        samples = _read_samples(recording, tool, settings, lambda _: None)
        return measure_reference(samples, tool, taken_at, person or None)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: is no reference grasp. {error}") from None


def check_reference_day(reference: ReferenceGrasp, recording: RecordingSource) -> None:
    """Refuse a reference grasp of another day than the recording; one of a day that is not known fits any.

    Raises:
        ConfigurationError: it is of another day.
    """
    recorded_at = recording.conditions.recorded_at
    if recorded_at and not is_same_day(recorded_at, reference.taken_at):
        raise ConfigurationError(
            f"{recording.path}: was recorded on {recorded_at:%Y-%m-%d %H:%M}, the reference grasp on "
            f"{reference.taken_at:%Y-%m-%d %H:%M}. Drive and cable differ from day to day: name a reference grasp of "
            "the same day with --reference, or leave it out."
        )


def open_recording(path: Path, tool: Tool) -> RecordingSource:
    """Open a recording of the tool.

    Raises:
        RecordingError: it cannot be read, or another tool or calibration recorded it.
    """
    recording = RecordingSource(path, tool)
    if recording.tool.calibration_fingerprint != tool.calibration_fingerprint:
        raise RecordingError(
            f"{path}: was recorded with the tool {recording.tool.name!r} as it was calibrated then, the others with "
            f"{tool.name!r}. A library is learned from recordings of one tool: leave this one out, or learn it apart."
        )
    return recording


def _read_samples(recording: RecordingSource, tool: Tool, settings: Settings, progress: Progress) -> np.ndarray:
    """Read a whole recording, calibrated and segmented, as (n,) of `SAMPLE_DTYPE`."""
    recording.skip_to_run()
    blocks = read_conditioned_blocks(recording, tool, settings.conditioning, progress)
    return np.concatenate([np.zeros(0, SAMPLE_DTYPE), *(block.samples for block in blocks)], dtype=SAMPLE_DTYPE)
