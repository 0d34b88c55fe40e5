"""Functions that collect the grasps of recordings for a table or an evaluation, as recorded or estimated anew."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.recordings.recording import RecordingSource, is_mcap
from app.host.background_process import SendMessage
from app.index.store import Store
from app.messages.annotations import GraspTruth
from app.messages.lab_sessions import LabSession
from app.recordings.grasp_rows import (
    GraspContext,
    RecordedGrasps,
    Row,
    build_grasp_rows,
    newest,
    read_recorded_grasps,
    session_columns,
)
from app.recordings.mcap_writer import RecordingContext
from config.errors import RecordingError
from config.schema import Settings, TissueLibrary, Tool

if TYPE_CHECKING:
    import pyarrow as pa

# The filters and pyarrow are imported where they are used: the server starts this work in another process.


@dataclass(frozen=True, slots=True)
class EstimationContext:
    """Tool, settings and library to estimate grasps with.

    If `library` is None, MCAP recordings keep their recorded answers, and other files use `default_library`.
    """

    tool: Tool
    settings: Settings
    library: TissueLibrary | None
    default_library: TissueLibrary


@dataclass(frozen=True, slots=True)
class Corrections:
    """What people have said of runs since they were recorded: newest truths by run and grasp, sessions by id."""

    truths: dict[str, dict[int, GraspTruth]]
    sessions: dict[str, LabSession]

    @classmethod
    def from_index(cls, store: Store) -> "Corrections":
        """Read all stated truths and laboratory sessions from the index.

        Raises:
            ServiceError: the index is at fault.
        """
        truths: dict[str, dict[int, GraspTruth]] = {}
        for truth in store.list_truths():
            truths.setdefault(truth.run_id, {})[truth.grasp] = truth
        return cls(truths, {session.id: session for session in store.list_lab_sessions()})


NO_CORRECTIONS = Corrections({}, {})


@dataclass(frozen=True, slots=True)
class CollectionJob:
    """One recording to collect grasps from. `label`: truth from the command line.

    With `may_be_left_out`, an unreadable recording gives a problem instead of an error.
    """

    path: Path
    how: EstimationContext
    corrections: Corrections
    label: str | None = None
    may_be_left_out: bool = False


@dataclass(frozen=True, slots=True)
class CollectedGrasps:
    """The rows of one recording, or why it is left out."""

    rows: list[Row]
    problem: str | None = None


def collect_grasps(job: CollectionJob) -> CollectedGrasps:
    """Collect the grasps of one recording.

    Raises:
        RecordingError: it cannot be read, and may not be left out.
        ConfigurationError: the library was learned with another tool.
    """
    try:
        rows = _collect_rows(job)
    except RecordingError as error:
        if not job.may_be_left_out:
            raise
        return CollectedGrasps([], str(error))
    if job.label:
        rows = [row | {"truth": job.label} if row["truth_version"] is None else row for row in rows]
    return CollectedGrasps(rows)


def _collect_rows(job: CollectionJob) -> list[Row]:
    path, how = job.path, job.how
    recorded = _read_corrected(path, job.corrections) if is_mcap(path) else None
    if recorded and how.library is None:
        return build_grasp_rows(
            recorded.context, recorded.grasps, recorded.spots, recorded.truths, recorded.run_start_s
        )
    from app.analysis.headless import replay_recording

    recording = RecordingSource(path, how.tool)
    library = how.library or how.default_library
    library.check_tool(recording.tool)
    made = replay_recording(recording, RecordingContext(recording.tool, library, how.settings), lambda share: None)
    at = recording.conditions.recorded_at
    context = recorded.context if recorded else GraspContext(recording=path.name, recorded_at=at and at.isoformat())
    context = replace(context, tool=recording.tool.name, library=library.name, force_scale=made.force_scale)
    truths = recorded.truths if recorded else {}
    run_start_s = recorded.run_start_s if recorded else 0.0
    if run_start_s is not None:  # the records' times count from the recording's first sample
        run_start_s -= recording.first_tick / recording.tool.board.sample_rate_hz
    return build_grasp_rows(context, made.grasps, made.spots, truths, run_start_s)


def _read_corrected(path: Path, corrections: Corrections) -> RecordedGrasps:
    recorded = read_recorded_grasps(path)
    truths = dict(recorded.truths)
    for grasp, truth in corrections.truths.get(recorded.context.run_id or "", {}).items():
        truths[grasp] = newest(truths.get(grasp), truth)
    session = corrections.sessions.get(recorded.context.session or "")
    context = replace(recorded.context, **session_columns(session)) if session else recorded.context
    return replace(recorded, truths=truths, context=context)


def build_table(rows: Sequence[Row]) -> "pa.Table":
    """Return the rows as a table; a column that a row lacks is empty there."""
    import pyarrow as pa

    names = dict.fromkeys(name for row in rows for name in row)
    return pa.Table.from_pylist([{name: row.get(name) for name in names} for row in rows])


def write_table(table: "pa.Table", suffix: str, out: "Path | pa.NativeFile") -> None:
    """Write a table to a file as `.csv` or `.parquet`.

    Raises:
        OSError: it cannot be written.
    """
    import pyarrow.csv
    import pyarrow.parquet

    (pyarrow.csv.write_csv if suffix == ".csv" else pyarrow.parquet.write_table)(table, out)


def collect_readable_grasps(
    paths: Sequence[Path], how: EstimationContext, corrections: Corrections
) -> tuple[list[Row], int]:
    """Return the rows of all recordings that can be read, and how many are left out.

    Raises:
        ConfigurationError: the library was learned with another tool.
    """
    found = [collect_grasps(CollectionJob(path, how, corrections, may_be_left_out=True)) for path in paths]
    return [row for each in found for row in each.rows], sum(each.problem is not None for each in found)


def send_grasp_table(
    send: SendMessage, paths: list[Path], corrections: Corrections, how: EstimationContext, suffix: str
) -> None:
    """Send the table of the grasps of all recordings that can be read, and how many are left out."""
    import pyarrow as pa

    rows, left_out = collect_readable_grasps(paths, how, corrections)
    out = pa.BufferOutputStream()
    write_table(build_table(rows), suffix, out)
    send((out.getvalue().to_pybytes(), left_out))
