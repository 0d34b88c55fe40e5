"""Functions that collect the grasps of many recordings for a table or an evaluation, on all cores."""

import contextlib
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.recordings.file_names import DEMO_ID_PREFIX
from app.cli.label_option import parse_labels_of
from app.cli.options import ProgressBar, find_data_folder
from config.errors import ConfigurationError, RecordingError
from config.schema import Settings, TissueLibrary, Tool

if TYPE_CHECKING:
    from app.messages.annotations import GraspTruth
    from app.recordings.grasp_rows import Row


@dataclass(frozen=True, slots=True)
class EstimationContext:
    """How grasps are estimated: as recorded if `library` is None; other files with `default_library`."""

    tool: Tool
    settings: Settings
    library: TissueLibrary | None
    default_library: TissueLibrary


@dataclass(frozen=True, slots=True)
class GraspsJob:
    """One recording, with the truth that was corrected since, and the label given on the command line."""

    path: Path
    how: EstimationContext
    corrected: "dict[int, GraspTruth]"
    label: str | None


def find_files(
    recordings: list[Path] | None, labels: list[str] | None, *, everything: bool, data: Path | None, settings: Settings
) -> tuple[list[Path], dict[Path, str]]:
    """Return the named recordings, with `everything` also the runs of the data folder, and the labels, by recording.

    Raises:
        ConfigurationError: none is named, or a label is not valid.
        RecordingError: a file is not there.
    """
    files = list(recordings or [])
    labeled = {path: name for name, paths in parse_labels_of(labels or [], files) for path in paths}
    files += [path for path in labeled if path not in files]
    if everything:
        folder = find_data_folder(data, settings) / "recordings"
        named = {path.resolve() for path in files}
        found = (path for path in folder.glob("*.mcap") if not path.name.startswith(DEMO_ID_PREFIX))
        files += sorted(path for path in found if path.resolve() not in named)
    files = list({path.resolve(): path for path in files}.values())
    if not files:
        raise ConfigurationError("Name recordings, or take all of the data folder with --all.")
    for path in files:
        if not path.is_file():
            raise RecordingError(f"{path}: there is no such file. Check the path.")
    return files, labeled


def read_corrected_truths(files: list[Path], data: Path, settings: Settings) -> dict[Path, "dict[int, GraspTruth]"]:
    """Return what people said of recordings in the data folder, which may have been corrected since."""
    from app.index.database import index_url_from_settings
    from app.index.opening import ingest_journal_tail
    from app.index.store import Store
    from app.recordings.grasp_rows import read_run_id  # slow imports

    folder = data / "recordings"
    own = [path for path in files if path.resolve().parent == folder.resolve()]
    if not own:
        return {}
    with contextlib.closing(Store(index_url_from_settings(settings, data))) as store:
        ingest_journal_tail(store, data / "journal.jsonl")
        return {path: {each.grasp: each for each in store.list_run_truths(read_run_id(path))} for path in own}


def collect(
    files: list[Path], how: EstimationContext, corrected: dict[Path, "dict[int, GraspTruth]"], labels: dict[Path, str]
) -> list["Row"]:
    """Return the rows of all files, in their order; several processes work on them."""
    from estimator.studies.case_runner import run_cases

    wanted = [GraspsJob(path, how, corrected.get(path, {}), labels.get(path)) for path in files]
    with ProgressBar("grasps", float(len(files))) as progress:
        if len(files) == 1:
            return collect_rows(wanted[0])
        jobs = min(len(files), len(os.sched_getaffinity(0)))
        return [row for rows in run_cases(collect_rows, wanted, lambda done, _: progress(done), jobs) for row in rows]


def collect_rows(job: GraspsJob) -> list["Row"]:
    """Return the rows of one recording.

    Raises:
        RecordingError: it cannot be read.
        ConfigurationError: the library was learned with another tool.
    """
    from acquisition.recordings.recording import RecordingSource, is_mcap
    from app.analysis.headless import replay_recording
    from app.recordings.grasp_rows import GraspContext, build_grasp_rows, newest, read_recorded_grasps
    from app.recordings.mcap_writer import RecordingContext

    path, how = job.path, job.how
    recorded = read_recorded_grasps(path) if is_mcap(path) else None
    if recorded and how.library is None:
        context, found, spots, truths = recorded.context, recorded.grasps, recorded.spots, recorded.truths
    else:
        recording = RecordingSource(path, how.tool)
        library = how.library or how.default_library
        library.check_tool(recording.tool)
        made = replay_recording(recording, RecordingContext(recording.tool, library, how.settings), lambda share: None)
        at = recording.conditions.recorded_at
        context = recorded.context if recorded else GraspContext(recording=path.name, recorded_at=at and at.isoformat())
        context = replace(context, tool=recording.tool.name, library=library.name, force_scale=made.force_scale)
        found, spots, truths = made.grasps, made.spots, dict(recorded.truths) if recorded else {}
    for grasp, truth in job.corrected.items():
        truths[grasp] = newest(truths.get(grasp), truth)
    rows = build_grasp_rows(context, found, spots, truths)
    return [row | {"truth": job.label} if job.label and row["truth_version"] is None else row for row in rows]
