"""The function behind `graspwatch import`: writes a recording from a log, with its estimates and origin."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from acquisition.recordings.conditioned_blocks import read_conditioned_blocks
from acquisition.recordings.file_names import check_run_name, remove_recording_suffix, to_printable
from acquisition.recordings.mcap_layout import RECORDED_AT_METADATA
from acquisition.recordings.recording import RecordingSource
from app.messages.lab_sessions import LabSession
from app.messages.runs import RunState
from app.recordings.answer_advice import explain_missing_answers
from app.recordings.headless_recorder import HeadlessRecorder, create_run
from app.recordings.mcap_writer import RECORDING_SUFFIX, RecordingContext
from config.errors import RecordingError
from estimator.estimate_block import GraspRecord
from estimator.online_estimator import TissueEstimator

IMPORTED_PROTOCOL = "imported"  # the commands are in the samples


@dataclass(frozen=True, slots=True)
class ImportedLog:
    """A log that was imported: its recording, and what the person should know of it."""

    path: Path
    remarks: tuple[str, ...]


def import_log(
    source: Path,
    folder: Path,
    recording_context: RecordingContext,
    tissue: str | None,
    progress: Callable[[float], None],
    name: str | None = None,
    lab_session: LabSession | None = None,
) -> ImportedLog:
    """Write the recording of another program's log into `folder`, complete or not at all.

    `recording_context.tool` names the log's channels and their calibration; `name` is that of the recording, by default
    that of the log; `lab_session` is the laboratory session that it belongs to.

    Raises:
        RecordingError: it cannot be read (the text names file and line), is an MCAP recording, was imported before, or
            there is no room.
        ConfigurationError: the name cannot be that of a recording.
    """
    name = check_run_name(name or remove_recording_suffix(source.name), "Give another one with --name.")
    path = folder / (name + RECORDING_SUFFIX)
    if path.exists():
        raise RecordingError(f"{path}: exists already, and is kept. Give the import another name with --name.")
    recording = RecordingSource(source, recording_context.tool)
    if recording.log is None:
        raise RecordingError(f"{source}: is an MCAP recording already. Copy it to {folder}.")
    started_ns, told = recording.log.find_start_ns()
    remarks = recording.remarks
    if started_ns is None:
        started_ns = source.stat().st_mtime_ns
        remarks += ("it does not say when it began: the time of the file's last change was taken",)
    about = {
        "imported_from": to_printable(source.name),
        "imported_sha256": hashlib.sha256(source.read_bytes()).hexdigest(),
        "imported_begun": told,
        "imported_remarks": "; ".join(remarks),
        RECORDED_AT_METADATA: _format_utc(started_ns),
    }
    run = create_run(name, IMPORTED_PROTOCOL, 1, tissue)
    run = run.model_copy(
        update={"started_at": _format_utc(started_ns), "session": lab_session.id if lab_session else None}
    )
    ended_at = _format_utc(started_ns + round(recording.duration_s * 1e9))
    tool, settings = recording_context.tool, recording_context.settings
    session = TissueEstimator(tool, recording_context.library, settings, recording.conditions)
    grasps: list[GraspRecord] = []
    with HeadlessRecorder(
        path,
        recording_context,
        run,
        started_ns=started_ns,
        metadata=about,
        lab_session=lab_session,
        discard_on_error=True,
    ) as file:
        for block in read_conditioned_blocks(recording, tool, settings.conditioning, progress):
            estimate = session.process(block)
            grasps += estimate.ended
            file.append(block, estimate)
        if last := session.finish():
            grasps.append(last)
        file.add_interrupted_grasp(last, session.spots)
        file.run = file.run.model_copy(update={"cycles": max(file.run.grasps, 1)})
        file.end_run(RunState.FINISHED, f"imported from {to_printable(source.name)}", ended_at)
    advice = explain_missing_answers(recording_context.tool, recording_context.library, grasps)
    return ImportedLog(path, (*remarks, advice.removesuffix(".")) if advice else remarks)


def _format_utc(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns // 1000 / 1e6, UTC).isoformat()
