"""Functions that collect the grasps of many recordings for a table or an evaluation, on all cores."""

import contextlib
import os
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.recordings.file_names import list_run_files
from app.cli.console import print_note
from app.cli.label_option import parse_labels_of
from app.cli.options import ProgressBar, find_data_folder
from config.errors import ConfigurationError, RecordingError
from config.schema import Settings

if TYPE_CHECKING:
    from app.analysis.grasp_collection import Corrections, EstimationContext
    from app.recordings.grasp_rows import Row


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
        files += list_run_files(find_data_folder(data, settings) / "recordings")
    by_place: dict[Path, Path] = {}
    for path in files:
        by_place.setdefault(path.resolve(), path)  # as it was named, because labels go by that
    files = list(by_place.values())
    if not files:
        raise ConfigurationError("Name recordings, or take all of the data folder with --all.")
    for path in files:
        if not path.is_file():
            raise RecordingError(f"{path}: there is no such file. Check the path.")
    return files, labeled


def read_corrections(files: list[Path], data: Path, settings: Settings) -> "Corrections":
    """Return what people have said of runs since they were recorded, if any of the files is in the data folder."""
    from app.analysis.grasp_collection import NO_CORRECTIONS, Corrections
    from app.index.database import index_url_from_settings
    from app.index.opening import ingest_journal_tail
    from app.index.store import Store  # slow imports

    folder = (data / "recordings").resolve()
    if all(path.resolve().parent != folder for path in files):
        return NO_CORRECTIONS
    with contextlib.closing(Store(index_url_from_settings(settings, data))) as store:
        ingest_journal_tail(store, data / "journal.jsonl")
        return Corrections.from_index(store)


def collect(
    files: list[Path],
    how: "EstimationContext",
    corrections: "Corrections",
    labels: dict[Path, str],
    required_files: Collection[Path],
) -> list["Row"]:
    """Return the rows of all files, in their order; several processes work on them.

    A file that cannot be read is left out with a note, unless it is one of `required_files`.

    Raises:
        RecordingError: a required file cannot be read.
        ConfigurationError: the library was learned with another tool.
    """
    from app.analysis.grasp_collection import CollectionJob, collect_grasps
    from estimator.studies.case_runner import run_cases

    wanted = [CollectionJob(path, how, corrections, labels.get(path), path not in required_files) for path in files]
    with ProgressBar("grasps", float(len(files))) as progress:
        if len(files) == 1:
            found = [collect_grasps(wanted[0])]
        else:
            jobs = min(len(files), len(os.sched_getaffinity(0)))
            found = run_cases(collect_grasps, wanted, lambda done, _: progress(done), jobs)
    for each in found:
        if each.problem:
            print_note(f"Left out: {each.problem}")
    return [row for each in found for row in each.rows]
