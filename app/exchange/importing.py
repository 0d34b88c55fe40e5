"""A LabVIEW log becomes a recording like any other: its samples, what is estimated of them, and where they are from."""

import hashlib
from collections.abc import Callable
from datetime import UTC
from pathlib import Path

from acquisition.pipeline import Pipeline
from acquisition.recordings.lvm import started_at
from acquisition.recordings.playing import Recording
from app.record.headless_file import ENDING, HeadlessFile, new_run
from app.record.run_file import Rig
from app.wire import RunState
from config.errors import RecordingError
from estimator.session import EstimationSession

PROTOCOL = "imported"  # what was commanded stands in the samples


def import_labview(source: Path, folder: Path, rig: Rig, tissue: str | None, progress: Callable[[float], None]) -> Path:
    """Write the recording of a LabVIEW log into `folder`; returns its file.

    `rig.tool` names its channels and their calibration.

    Raises:
        RecordingError: it cannot be read (names file and line), is no LabVIEW log, was imported before, or there is no
            room.
    """
    path = folder / (_stem(source) + ENDING)
    recording = Recording(source, rig.tool)
    if recording.container:
        raise RecordingError(f"{source}: is an MCAP recording already. Copy it to {folder}.")
    began = started_at(source)
    about = {
        "imported_from": source.name,
        "imported_sha256": hashlib.sha256(source.read_bytes()).hexdigest(),
        "imported_begun": f"{began.isoformat()}, in a zone that it does not say" if began else "not said",
    }
    started_ns = round(began.replace(tzinfo=UTC).timestamp() * 1e6) * 1000 if began else source.stat().st_mtime_ns
    run = new_run(path.stem, PROTOCOL, 1, tissue)
    if began:
        run = run.model_copy(update={"started_at": began.replace(tzinfo=UTC).isoformat()})
    with recording, HeadlessFile(path, rig, run, started_ns=started_ns, about=about, can_be_repeated=True) as file:
        _take(recording, rig, file, progress)
        file.run = file.run.model_copy(update={"cycles": max(file.run.grasps, 1)})
        file.run_ended(RunState.FINISHED, f"imported from {source.name}")
    return path


def _take(recording: Recording, rig: Rig, file: HeadlessFile, progress: Callable[[float], None]) -> None:
    pipeline = Pipeline(rig.tool, rig.settings.conditioning)
    session = EstimationSession(rig.tool, rig.library, rig.settings)
    done = 0
    while (raw := recording.read_block()) is not None:
        block = pipeline.process(raw)
        file.take(block, session.process(block))
        done += len(raw)
        progress(done / recording.samples)
    file.cut_short(session.finish())


def _stem(source: Path) -> str:
    name = source.name
    for ending in (".gz", ".lvm"):
        name = name.removesuffix(ending)
    return name
