"""Notices: what the processes of a service tell each other, beside samples, estimates and commands.

`acquisition/bus.py` packs and unpacks them. `Notice` is the whole set. `realtime` says which scheduling the system
granted a process.
"""

from dataclasses import dataclass
from enum import StrEnum


class RunOutcome(StrEnum):
    """How a run ended."""

    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"


# --- of the acquisition ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Acquiring:
    """Notice that the acquisition has opened the tool and reads samples."""

    realtime: str


@dataclass(frozen=True, slots=True)
class AcquisitionFailed:
    """Notice that the acquisition ends with an error."""

    text: str


@dataclass(frozen=True, slots=True)
class AcquisitionStalled:
    """Notice that the acquisition was held up, and reads samples again."""

    text: str


@dataclass(frozen=True, slots=True)
class WaitingForSamples:
    """The acquisition's sign of life while a device without a motor gives no samples."""

    why: str


@dataclass(frozen=True, slots=True)
class GraspReleased:
    """Notice that the limiter released a grasp: the motor is at zero until the protocol's next grasp."""

    text: str


@dataclass(frozen=True, slots=True)
class RunEnded:
    """Notice that a run is over, and the motor is at zero."""

    run_id: str
    end: RunOutcome
    why: str


# --- of the estimator ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CompilingFilters:
    """Notice that the estimator compiles its filters, which takes up to a minute."""


@dataclass(frozen=True, slots=True)
class Estimating:
    """Notice that the estimator processes samples; repeated once a second."""

    realtime: str


# --- of the server ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RunMetadata:
    """Description of a run before it begins.

    `protocol` is its JSON, `reference` that of the day's reference grasp, `session` that of the laboratory session.
    """

    run_id: str
    protocol: str
    cycles: int
    tissue: str | None
    by: str | None
    reference: str | None = None
    session: str | None = None


# --- of the recorder -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """The recorder's state, which is also its sign of life; `file` is None while none is written."""

    file: str | None
    samples: int
    missing_blocks: int
    realtime: str


@dataclass(frozen=True, slots=True)
class RecordingFileClosed:
    """Notice that a recording file was closed and can be indexed; `sha256` is None if it is not complete."""

    file: str
    sha256: str | None


@dataclass(frozen=True, slots=True)
class RecordingRecovered:
    """Notice that a recording file, which an earlier recorder left cut off, has been repaired."""

    file: str
    sha256: str


@dataclass(frozen=True, slots=True)
class RecordingStopped:
    """Notice that a recording ended before its run."""

    text: str


# --- of the safety monitor -------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Monitoring:
    """The safety monitor's sign of life."""

    realtime: str


@dataclass(frozen=True, slots=True)
class MotorZeroed:
    """Notice that the acquisition fell silent in a run, and a reset of the board has brought the motor to zero."""

    text: str


@dataclass(frozen=True, slots=True)
class MotorNotZeroed:
    """Notice that the acquisition fell silent in a run, and the board could not be reset."""

    text: str


# --- of the Foxglove worker ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FoxgloveServing:
    """The Foxglove worker's sign of life."""


Notice = (
    Acquiring
    | AcquisitionFailed
    | AcquisitionStalled
    | WaitingForSamples
    | GraspReleased
    | RunEnded
    | CompilingFilters
    | Estimating
    | RunMetadata
    | RecorderStatus
    | RecordingFileClosed
    | RecordingRecovered
    | RecordingStopped
    | Monitoring
    | MotorZeroed
    | MotorNotZeroed
    | FoxgloveServing
)
