"""Import of a LabVIEW log as a recording, with its samples, estimates and origin."""

import hashlib
from collections.abc import Callable
from datetime import UTC
from pathlib import Path

from acquisition.recordings.conditioned_blocks import read_conditioned_blocks
from acquisition.recordings.labview import read_start_time
from acquisition.recordings.recording import RecordingSource
from app.messages.wire import RunState
from app.recordings.headless_recorder import HeadlessRecorder, create_run
from app.recordings.mcap_writer import RECORDING_SUFFIX, RecordingContext
from config.errors import RecordingError
from estimator.online_estimator import TissueEstimator

IMPORTED_PROTOCOL = "imported"  # the commands are in the samples


def import_labview(
    source: Path,
    folder: Path,
    recording_context: RecordingContext,
    tissue: str | None,
    progress: Callable[[float], None],
) -> Path:
    """Write the recording of a LabVIEW log into `folder`; return its file.

    `recording_context.tool` names the log's channels and their calibration.

    Raises:
        RecordingError: it cannot be read (the text names file and line), is no LabVIEW log, was imported before, or
            there is no room.
    """
    path = folder / (_name_without_suffixes(source) + RECORDING_SUFFIX)
    recording = RecordingSource(source, recording_context.tool)
    if recording.mcap_file:
        raise RecordingError(f"{source}: is an MCAP recording already. Copy it to {folder}.")
    began = read_start_time(source)
    about = {
        "imported_from": source.name,
        "imported_sha256": hashlib.sha256(source.read_bytes()).hexdigest(),
        "imported_begun": f"{began.isoformat()}, in a zone that it does not say" if began else "not said",
    }
    started_ns = round(began.replace(tzinfo=UTC).timestamp() * 1e6) * 1000 if began else source.stat().st_mtime_ns
    run = create_run(path.stem, IMPORTED_PROTOCOL, 1, tissue)
    if began:
        run = run.model_copy(update={"started_at": began.replace(tzinfo=UTC).isoformat()})
    tool, settings = recording_context.tool, recording_context.settings
    session = TissueEstimator(tool, recording_context.library, settings)
    with HeadlessRecorder(
        path, recording_context, run, started_ns=started_ns, metadata=about, discard_on_error=True
    ) as file:
        for block in read_conditioned_blocks(recording, tool, settings.conditioning, progress):
            file.append(block, session.process(block))
        file.add_interrupted_grasp(session.finish())
        file.run = file.run.model_copy(update={"cycles": max(file.run.grasps, 1)})
        file.end_run(RunState.FINISHED, f"imported from {source.name}")
    return path


def _name_without_suffixes(source: Path) -> str:
    name = source.name
    for ending in (".gz", ".lvm"):
        name = name.removesuffix(ending)
    return name
