"""Functions for the tidy table of grasps: one row a grasp, one value a cell, of recordings and of the index alike."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from acquisition.recordings.mcap_layout import RECORDED_AT_METADATA, SESSION_ATTACHMENT
from acquisition.recordings.mcap_reader import COPY_AGAIN_TEXT, JsonMessage, McapFile
from app.messages.annotations import GraspTruth
from app.messages.grasps import GraspEnded, Identification
from app.messages.journal import JournalEntry
from app.messages.lab_sessions import LabSession
from app.messages.runs import Run
from app.messages.stored import read_stored
from app.recordings.topics import GRASP_TOPIC, IDENTIFICATION_TOPIC, JOURNAL_TOPIC, RUN_TOPIC, decode_message
from config.errors import RecordingError
from estimator.estimate_block import GraspRecord, SpotVerdict

Row = dict[str, Any]
TIME_COLUMNS = ("start_s", "contact_s", "end_s")


@dataclass(frozen=True, slots=True)
class GraspContext:
    """What the grasps of one recording have in common; None: not known."""

    recording: str | None = None
    run_id: str | None = None
    session: str | None = None
    subject: str | None = None
    species: str | None = None
    specimen: str | None = None
    condition: str | None = None
    operator: str | None = None
    protocol_number: str | None = None
    session_notes: str | None = None
    recorded_at: str | None = None
    protocol: str | None = None
    tissue: str | None = None
    tool: str | None = None
    library: str | None = None
    force_scale: str | None = None
    session_fields: dict[str, str] = field(default_factory=dict)
    """The laboratory's own fields of the session; each has a column `field_<name>`."""


@dataclass(frozen=True, slots=True)
class RecordedGrasps:
    """The grasps of a recording as they were estimated when it was made."""

    context: GraspContext
    grasps: tuple[GraspRecord, ...]
    spots: tuple[SpotVerdict, ...]
    truths: dict[int, GraspTruth]
    run_start_s: float | None
    """Time of the run's first sample, by the clock of the grasps' times; None: not known."""


def read_recorded_grasps(path: Path) -> RecordedGrasps:
    """Read the grasps of an MCAP recording, with the ground truth that was stated while it was made.

    Raises:
        RecordingError: it cannot be read.
    """
    container = McapFile(path)
    about = container.metadata
    run_start_s = _read_run_start(container)
    grasps: dict[int, GraspRecord] = {}
    truths: dict[int, GraspTruth] = {}
    spots: tuple[SpotVerdict, ...] = ()
    run: Run | None = None
    for each in container.iter_content(GRASP_TOPIC, IDENTIFICATION_TOPIC, JOURNAL_TOPIC, RUN_TOPIC):
        if not isinstance(each, JsonMessage):
            raise RecordingError(f"{path}: its messages {each.topic} are none of this program.")
        try:
            message = decode_message(each.topic, each.content)
        except ValueError as error:
            raise RecordingError(f"{path}: holds a message that cannot be read ({error}).") from None
        match message:
            case GraspEnded() if message.run_id == about.get("run_id"):
                grasps[message.grasp.index] = message.grasp
            case Identification() if message.spots:
                spots = message.spots
            case JournalEntry() if message.truth and message.truth.run_id == about.get("run_id"):
                truths[message.truth.grasp] = newest(truths.get(message.truth.grasp), message.truth)
            case Run() if message.id == about.get("run_id"):
                run = message
    session = _read_lab_session(container)
    context = GraspContext(
        recording=path.name,
        run_id=about.get("run_id"),
        **session_columns(session),
        recorded_at=about.get(RECORDED_AT_METADATA) or (run.started_at if run else None),
        protocol=about.get("protocol"),
        tissue=about.get("tissue") or None,
        tool=about.get("tool"),
        library=about.get("library"),
        force_scale=about.get("force_scale"),
    )
    return RecordedGrasps(context, tuple(grasps.values()), spots, truths, run_start_s)


def _read_run_start(container: McapFile) -> float | None:
    """Return the time of the run's first sample, s; None if that is in another file, which is not here.

    Raises:
        RecordingError: the file does not say it.
    """
    about = container.metadata
    if continued := about.get("continues"):
        first = container.path.with_name(f"{continued}{container.path.suffix}")
        if not first.is_file():
            return None
        about = McapFile(first).metadata
    try:
        return int(about["run_first_tick"]) / float(about["sample_rate_hz"])
    except (KeyError, ValueError, ArithmeticError):
        raise RecordingError(f"{container.path}: does not say where its run begins. {COPY_AGAIN_TEXT}") from None


def _read_lab_session(container: McapFile) -> LabSession | None:
    """Return the laboratory session as it was described when the run began; None without one.

    Raises:
        RecordingError: it cannot be read.
    """
    content = container.attachments.get(SESSION_ATTACHMENT)
    try:
        return read_stored(LabSession, content) if content else None
    except ValueError as error:
        raise RecordingError(f"{container.path}: its laboratory session cannot be read ({error}).") from None


def session_columns(session: LabSession | None) -> dict[str, Any]:
    """Return the columns of a laboratory session, named as in `GraspContext`."""
    if session is None:
        return {}
    return {
        "session": session.id,
        "subject": session.subject,
        "species": session.species,
        "specimen": session.specimen,
        "condition": session.condition.value,
        "operator": session.operator,
        "protocol_number": session.protocol_number,
        "session_notes": session.notes,
        "session_fields": session.fields,
    }


def newest(known: GraspTruth | None, other: GraspTruth) -> GraspTruth:
    """Return the one of two statements about a grasp that counts."""
    return other if known is None or other.version >= known.version else known


def build_grasp_rows(
    context: GraspContext,
    grasps: Iterable[GraspRecord],
    spots: Sequence[SpotVerdict],
    truths: dict[int, GraspTruth],
    run_start_s: float | None,
) -> list[Row]:
    """Return a row for each grasp. Names carry their units; each tissue's value has a column of its own.

    `start_s`, `contact_s` and `end_s` count from the run's first sample. `run_start_s` is its time by the clock of the
    records; None: not known, and the three are empty.
    """
    rows = []
    for grasp in grasps:
        truth = truths.get(grasp.index)
        spot = next((spot for spot in reversed(spots) if spot.began_s <= grasp.start_s), None)
        row: Row = {name: getattr(context, name) for name in GraspContext.__slots__ if name != "session_fields"}
        row |= {f"field_{name}": value for name, value in context.session_fields.items()}
        row |= {
            "truth": truth.held if truth else None,
            "truth_remark": truth.remark.value if truth and truth.remark else None,
            "truth_place": truth.place if truth else None,
            "truth_by": truth.by if truth else None,
            "truth_version": truth.version if truth else None,
            "spot": spot.index if spot else None,
            "spot_label": spot.label if spot else None,
            "spot_probability": spot.probability if spot else None,
        }
        times = {name: getattr(grasp, name) for name in TIME_COLUMNS}
        since_start = {
            name: None if at is None or run_start_s is None else at - run_start_s for name, at in times.items()
        }
        rows.append(row | flatten_grasp(grasp) | since_start)
    return rows


def flatten_grasp(grasp: GraspRecord) -> Row:
    """Return the values of a grasp, each tissue's in a column of its own."""
    row: Row = {}
    for name, value in grasp.model_dump(mode="json").items():
        if isinstance(value, dict):
            row |= {f"{name}_{key}": each for key, each in value.items()}
        else:
            row[name] = "; ".join(value) if isinstance(value, list) else value
    return row
