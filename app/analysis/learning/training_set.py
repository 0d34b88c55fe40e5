"""The function that reads labeled recordings, and refuses those from which no library can be learned."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.analysis.learning.grasp_reader import read_grasps, read_reference, recording_sha256
from config.errors import ConfigurationError, RecordingError
from config.schema import ReferenceGrasp, Settings, SourceConditions, TissueLibrary, Tool, is_same_day
from estimator.learning.parameter_fit import compute_initial_guess
from estimator.learning.recorded_grasps import (
    LabeledRecording,
    LoadingCurves,
    estimate_usual_peak_v,
    extract_loading_curves,
)

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class TrainingSet:
    """Labeled recordings with their loading curves; `peak_v` is the grasps' usual peak command, V."""

    recordings: list[LabeledRecording]
    curves: list[LoadingCurves]
    peak_v: float
    remarks: list[str]


def load_training_set(
    files: dict[str, list[Path]],
    tool: Tool,
    base: TissueLibrary,
    settings: Settings,
    min_grasps: int,
    progress: Progress,
    references: Sequence[Path] = (),
) -> TrainingSet:
    """Read every grasp of the labeled files, and return them with their loading curves.

    `references`: recordings with empty jaws, each for those recordings of its day that hold no reference grasp.

    Raises:
        RecordingError: a file cannot be read, or was recorded with another tool.
        ConfigurationError: a recording has two labels, a tissue has too few grasps, or a reference grasp is of a day
            without recordings.
        CalibrationError: a reference is none.
    """
    unique, remarks = _remove_duplicates(files)
    measured = {path: read_reference(path, tool, settings) for path in references}
    guess, total = compute_initial_guess(base), sum(map(len, unique.values()))
    recordings: list[LabeledRecording] = []
    for label, paths in unique.items():
        for path in paths:
            done = len(recordings)
            recordings.append(
                read_grasps(
                    label, path, tool, settings, guess, lambda share, done=done: progress((done + share) / total)
                )
            )
            _check_rest_voltage(recordings[-1], path, tool)
    recordings = _add_references(recordings, measured)
    remarks += _describe_missing_references(recordings)
    peak_v = estimate_usual_peak_v(recordings)
    curves = [extract_loading_curves(each, tool, peak_v) for each in recordings] if np.isfinite(peak_v) else []
    _check_grasp_counts(recordings, curves, min_grasps)
    return TrainingSet(recordings, curves, peak_v, remarks)


def _remove_duplicates(files: dict[str, list[Path]]) -> tuple[dict[str, list[Path]], list[str]]:
    """Keep each recording once, by its content; refuse one with two labels."""
    seen: dict[str, tuple[str, Path]] = {}
    unique: dict[str, list[Path]] = {}
    remarks = []
    for label, paths in files.items():
        for path in paths:
            sha256 = recording_sha256(path)
            if sha256 not in seen:
                seen[sha256] = label, path
                unique.setdefault(label, []).append(path)
                continue
            other, first = seen[sha256]
            if other != label:
                raise ConfigurationError(
                    f"{path}: the same recording is labelled {other!r} (as {first}) and {label!r}. Keep the label that "
                    "is right and leave the other out."
                )
            remarks.append(f"{path}: the same recording as {first}; it counts once.")
    return unique, remarks


def _add_references(
    recordings: list[LabeledRecording], references: dict[Path, ReferenceGrasp]
) -> list[LabeledRecording]:
    """Give each recording without a reference grasp the nearest one of its day.

    Raises:
        ConfigurationError: a reference grasp is of a day without recordings.
    """
    for path, reference in references.items():
        if not any(is_same_day(each.conditions.recorded_at, reference.taken_at) for each in recordings):
            days = ", ".join(sorted({_format_day(each) for each in recordings}))
            raise ConfigurationError(
                f"{path}: the reference grasp is of {reference.taken_at:%Y-%m-%d}, the recordings of {days}: no "
                "recording is of its day. Name a reference grasp of the same day, or leave it out."
            )
    return [_add_reference(each, references.values()) for each in recordings]


def _add_reference(recording: LabeledRecording, references: Iterable[ReferenceGrasp]) -> LabeledRecording:
    recorded_at = recording.conditions.recorded_at
    if recording.conditions.reference or recorded_at is None:
        return recording
    own = [each for each in references if is_same_day(recorded_at, each.taken_at)]
    nearest = min(own, key=lambda each: abs(each.taken_at - recorded_at), default=None)
    return replace(recording, conditions=SourceConditions(recorded_at, nearest))


def _describe_missing_references(recordings: Sequence[LabeledRecording]) -> list[str]:
    """Return one remark about the days without a reference grasp, if there are any."""
    lacking = [each for each in recordings if each.conditions.reference is None]
    if not lacking:
        return []
    days = ", ".join(sorted({_format_day(each) for each in lacking}))
    return [
        f"{len(lacking)} of {len(recordings)} recordings have no reference grasp (day: {days}). So the stall counts "
        "less for grasps of other days. If there is a recording with empty jaws of that day, name it with --reference."
    ]


def _format_day(recording: LabeledRecording) -> str:
    recorded_at = recording.conditions.recorded_at
    return f"{recorded_at:%Y-%m-%d}" if recorded_at else "not known"


def _check_rest_voltage(recording: LabeledRecording, path: Path, tool: Tool) -> None:
    """Refuse a recording whose strain gage rests at another voltage: another tool or calibration recorded it."""
    if tool.hand_driven:
        return  # a hand presses before the jaws move, so that no sample of a grasp need be at rest
    calibration = tool.calibration
    lowest = [float(np.percentile(grasp.samples["strain_v"], 2)) for grasp in recording.grasps if len(grasp.samples)]
    off_v = float(np.median(lowest)) - calibration.rest_offset_v if lowest else 0.0
    if abs(off_v) > 2 * calibration.rest_tolerance_v:
        raise RecordingError(
            f"{path}: its strain gage rests at {calibration.rest_offset_v + off_v:.2f} V, that of {tool.name!r} at "
            f"{calibration.rest_offset_v:.2f} V: it was recorded with another tool or calibration. A library is "
            "learned from recordings of one tool: leave this one out, or name its tool file with --tool and learn it "
            "apart."
        )


def _check_grasp_counts(recordings: list[LabeledRecording], curves: list[LoadingCurves], min_grasps: int) -> None:
    """Refuse tissues with too few grasps; the text says how many are missing and why others did not count."""
    missing = []
    for label in dict.fromkeys(each.label for each in recordings):
        own = [each for each in curves if each.recording.label == label]
        sound = sum(len(each.features) for each in own)
        if sound >= min_grasps:
            continue
        there = sum(len(each.grasps) for each in recordings if each.label == label)
        missing.append(
            f"{label}: {sound} grasps to learn from, {min_grasps - sound} missing ({_describe_exclusions(own, there)})"
        )
    if missing:
        raise ConfigurationError(
            f"Too few grasps; each tissue needs {min_grasps}:\n"
            + "\n".join(missing)
            + "\nAdd recordings of these tissues, "
            "leave their labels out, or lower --least."
        )


def _describe_exclusions(curves: list[LoadingCurves], recorded_grasps: int) -> str:
    if recorded_grasps == 0:
        return "its recordings hold no grasp: the command never leaves zero"
    reasons: dict[str, int] = {}
    for text in (each for some in curves for each in some.left_out):
        reason = text.partition(": ")[2]
        reasons[reason] = reasons.get(reason, 0) + 1
    left = "; ".join(f"{count} left out, {reason}" for reason, count in reasons.items())
    return f"{recorded_grasps} recorded" + (f"; {left}" if left else "; no force rose in them")
