"""The whole contract with browsers and programs: WebSocket messages, REST bodies, and the binary sample frame.

`/api/live` sends one `Hello`, then JSON messages and binary sample frames. For a slow viewer, it drops the
oldest frames, but never a message. A viewer answers each frame with `FrameReceived`.
`/api/recordings/{name}/replay` sends the same for a recording, and a `ReplayState` at every change and ten times a
second. It obeys `ReplayControl`; after a jump it begins again with a `Hello`.

Binary frame, little-endian: `FRAME_HEADER`, then `columns` float32 columns of `rows` values each, in the order of
`Hello.channels`; NaN means "no value". Rows are consecutive ticks (1 tick = 1 sample) beginning at `first_tick`.

The dashboard's TypeScript types are generated from this module (`make wire`).
"""

import struct
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field

from acquisition.safety_state_machine import Safety
from config.schema import ToolKind
from estimator.force_alarms import Priority

SCHEMA_VERSION = 3

# magic, kind, stride (reserved, 1), columns, rows, sequence, first_tick, newest_ms
FRAME_HEADER = struct.Struct("<4sBBHIIdd")
FRAME_MAGIC = b"GWF1"


class FrameKind(StrEnum):
    """The kind of a frame: new samples, or the last seconds before the viewer connected. On the wire: 0 and 1."""

    LIVE = "live"
    HISTORY = "history"


FRAME_KINDS = {FrameKind.LIVE: 0, FrameKind.HISTORY: 1}


PersonName = Annotated[str, Field(min_length=1, max_length=40, pattern=r"\S")]


Reason = Annotated[str, Field(min_length=3, max_length=300, pattern=r"\S")]
UNMEASURED_SCALE_DESCRIPTION = (
    "Why a real tool may be armed although its force scale is not measured: an admin's reason, for the journal"
)


class WireModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="null")


class Phase(StrEnum):
    """The phase of the service."""

    STARTING = "starting"
    IDLE = "idle"
    RUNNING = "running"
    REPLAY = "replay"
    """The service has no tool and only shows recordings."""
    FAULTED = "faulted"


class RunState(StrEnum):
    RUNNING = "running"
    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"


class Role(StrEnum):
    """The permissions of a token; each role includes the roles before it."""

    VIEWER = "viewer"
    """May watch and press STOP."""
    OPERATOR = "operator"
    """May run protocols and acknowledge alarms."""
    ADMIN = "admin"
    """May delete recordings."""

    def includes(self, other: "Role") -> bool:
        order = list(Role)
        return order.index(self) >= order.index(other)


class AlarmKind(StrEnum):
    FORCE = "force"
    TECHNICAL = "technical"


class ChannelInfo(WireModel):
    """One column of the sample frames."""

    name: str
    unit: str
    tissue: str | None = None


class HoldableInfo(WireModel):
    """A tissue that the simulated grasper can hold."""

    name: str
    title: str
    in_library: bool


class SpreadInfo(WireModel):
    """Standard deviations between specimens of a tissue, of natural logarithms."""

    log_alpha: float
    log_beta: float
    log_damping: float
    log_thickness: float


class TissueInfo(WireModel):
    """A tissue profile of the library in use."""

    name: str
    title: str
    alpha_n: float
    beta_per_m: float
    damping_kg_per_s: float
    thickness_m: float
    threshold_n: float
    threshold_pa: float
    spread: SpreadInfo


class LibraryInfo(WireModel):
    """The tissue library in use."""

    name: str
    title: str
    source: str
    mass_kg: float
    jaw_area_m2: float
    tissues: list[TissueInfo]


class ForceScaleInfo(WireModel):
    """The force scale: jaw force is Eq. (2) times `value`, whose true value lies between `low` and `high`."""

    value: float
    low: float
    high: float
    measured: bool
    source: str
    date: str | None
    expires: str | None
    text: str = Field(description="The force scale in words, to show beside newtons")


class ConstantInfo(WireModel):
    """A calibrated constant of the tool file, with its measurement date."""

    constant: str = Field(description="Key of the constant in the tool file")
    value: float
    date: str
    by: str = Field(description="Person who measured the constant, or its source")
    expires: str | None = Field(description="Day from which a new measurement is due; null: not given")
    expired: bool


class ToolInfo(WireModel):
    name: str
    title: str
    kind: ToolKind
    sample_rate_hz: float
    max_command_v: float
    force_ceiling_n: float
    force_scale: ForceScaleInfo
    calibration_date: str = Field(description="Date of the constants that have no date of their own")
    calibrated_by: str


class ProtocolInfo(WireModel):
    """A protocol with its waveform for a preview: the motor command over one cycle."""

    name: str
    title: str
    cycles: int
    cycle_s: float
    peak_command_v: float
    refused: str | None = Field(description="Why this tool cannot play the protocol, whose waveform is then empty")
    time_s: list[float]
    command_v: list[float]


class RunRequest(WireModel):
    """Start a protocol."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"protocol": "trapezoid_2hz", "cycles": 3, "tissue": "liver"}]}
    )

    protocol: str = Field(description="Name of a protocol, see GET /api/protocols")
    cycles: Annotated[int, Field(ge=1, le=10_000)] | None = Field(
        default=None, description="Grasps; null: the protocol's"
    )
    tissue: str | None = Field(
        default=None, description="Tissue that the simulated grasper holds; refused for a real tool"
    )
    by: PersonName | None = Field(default=None, description="Name of the requester")
    unmeasured_scale: Reason | None = Field(default=None, description=UNMEASURED_SCALE_DESCRIPTION)


class ArmRequest(WireModel):
    """Arm the tool. The body is optional."""

    by: PersonName | None = None
    unmeasured_scale: Reason | None = Field(default=None, description=UNMEASURED_SCALE_DESCRIPTION)


class SafetyReport(WireModel):
    """The safety state of the tool after it was armed or disarmed."""

    safety: Safety


class StopRequest(WireModel):
    """Stop the motor. The body is optional."""

    by: PersonName | None = None


class Run(WireModel):
    """One run of a protocol."""

    id: str
    protocol: str
    cycles: int
    tissue: str | None
    by: str | None = Field(description="Person who started the run")
    state: RunState
    started_at: str
    ended_at: str | None
    why: str | None = Field(description="Why the run stopped or failed")
    grasps: int


class Grasp(WireModel):
    """A finished grasp. A field without a value is null."""

    index: int
    start_s: float
    contact_s: float | None
    end_s: float
    label: str = Field(description="A tissue's name, `unknown` or `undecided`")
    probability: float | None
    probabilities: dict[str, float]
    time_to_decision_s: float | None
    alpha_n: float | None
    beta_per_m: float | None
    damping_kg_per_s: float | None
    peak_force_n: float | None
    peak_displacement_m: float | None
    convergence_s: dict[str, float | None]
    force_error_n: dict[str, float | None]
    valid: bool
    why_invalid: str | None
    alarms: list[Priority] = Field(description="Force warnings during the grasp: the highest of each rise of the force")
    held_back: bool = Field(description="Whether the limiter kept the command lower than the protocol asks for")
    peak_share_of_limit: float | None = Field(
        default=None,
        description="Highest ratio of the force to the limit enforced at that time; null: no limit was enforced",
    )


class Hello(WireModel):
    """The first message on a connection: what the service is and what it sends."""

    type: Literal["hello"] = "hello"
    schema_version: int = SCHEMA_VERSION
    version: str
    server_time_ms: float
    tool: ToolInfo
    library: LibraryInfo
    holdable: list[HoldableInfo] = Field(description="Empty for a real tool")
    lowest_threshold_n: float
    decide_at: float = Field(description="Probability from which a tissue is named")
    warning_shares: list[float] = Field(description="Low, medium and high warning, as shares of the threshold")
    channels: list[ChannelInfo]
    frame_rate_hz: float


class RecordingState(WireModel):
    """The state of the recorder."""

    enabled: bool
    file: str | None = Field(description="File being written; null: no run is under way, or it is not recorded")
    samples: int = Field(description="Samples in that file so far, including those before the run")
    missing_blocks: int = Field(description="Blocks that never reached the recorder")
    problem: str | None = Field(description="Why the last recording ended before its run did")


RECORDER_OFF = RecordingState(enabled=False, file=None, samples=0, missing_blocks=0, problem=None)


class State(WireModel):
    """The state of the service, sent once a second and at every change."""

    type: Literal["state"] = "state"
    server_time_ms: float
    phase: Phase
    safety: Safety = Field(description="Safety state; the motor moves only in `running` and `holding back`")
    safety_why: str | None = Field(description="Why the tool is faulted, or was not armed")
    run: Run | None
    last_run: Run | None
    limit_n: float | None = Field(description="Limit that the limiter enforces now, N; null: no limit is enforced")
    simulated_tissue: str | None
    demo: str | None = Field(description="What the demonstration shows now; null: no demonstration runs")
    control: str | None = Field(description="Person in control, else the one who started the run; null: neither")
    rate_hz: float
    lost_samples: int
    estimator_latency_ms: float | None
    viewers: int
    recording: RecordingState
    free_disk_bytes: int | None = Field(description="Null: the data folder is missing")
    faults: list[str]


class Identification(WireModel):
    """The answer for the grasp under way, sent at every change and ten times a second during a grasp."""

    type: Literal["identification"] = "identification"
    server_time_ms: float
    tick: int
    grasp: int = Field(description="0 before the first grasp")
    in_grasp: bool
    in_contact: bool
    label: str
    probability: float | None
    probabilities: dict[str, float]
    time_to_decision_s: float | None
    force_n: float | None
    peak_force_n: float | None
    threshold_n: float = Field(description="Injury threshold in force, for force alarms; no limit of the motor")
    threshold_tissue: str | None = Field(description="Tissue of this threshold; null: the library's lowest one applies")
    limit_n: float | None = Field(description="Limit that the limiter enforces; null: no limit is enforced")
    holding_back: bool = Field(description="Whether the limiter keeps the command lower than the protocol asks for")
    time_to_limit_s: float | None = Field(description="Until the force reaches the limit; null unless it rises")
    thickness_m: float | None = Field(description="Thickness of the tissue, where the tool can measure it at contact")
    convergence_s: dict[str, float | None]
    force_error_n: dict[str, float | None]


class GraspEnded(WireModel):
    type: Literal["grasp"] = "grasp"
    run_id: str | None
    grasp: Grasp


class Alarm(WireModel):
    """An alarm began, changed or ended. It keeps its `id` until it is neither `active` nor `latched`."""

    type: Literal["alarm"] = "alarm"
    id: str
    kind: AlarmKind
    priority: Priority
    active: bool = Field(description="Whether the cause persists")
    latched: bool = Field(description="Whether the alarm stays until a person acknowledges it")
    text: str
    value: float | None = Field(description="Value that passed `limit`; later the highest so far")
    limit: float | None = Field(description="Bound for `value`: of a force alarm, the injury threshold")
    unit: str | None
    began_ms: float
    ended_ms: float | None = Field(description="When the cause ended")
    acknowledged_by: str | None = Field(description="Null: not acknowledged, or the alarm became worse since")
    change: Annotated[int, Field(ge=1)] = Field(
        default=1, description="Message number within the alarm; the highest is newest"
    )


class AcknowledgeRequest(WireModel):
    """Acknowledge an alarm that a person has seen."""

    by: PersonName | None = Field(
        default=None, description="Name of the person; optional for a person who is signed in"
    )
    priority: Priority = Field(description="Priority that the person saw; refused if the alarm is worse now")


class EventMessage(WireModel):
    """A line for the log, such as a start, a stop, a refusal, a loss, or the withdrawal of a tissue's name."""

    type: Literal["event"] = "event"
    server_time_ms: float
    text: str


class FrameReceived(WireModel):
    """A viewer's answer to a sample frame. Without answers, the server stops sending frames after a few."""

    type: Literal["received"] = "received"
    sequence: int


class ReplayControl(WireModel):
    """A viewer's command to a replay; null leaves a value unchanged."""

    type: Literal["replay"] = "replay"
    playing: bool | None = None
    position_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    speed: Annotated[float, Field(ge=0.25, le=10)] | None = None


class ReplayState(WireModel):
    """The state of a replay."""

    type: Literal["replay_state"] = "replay_state"
    name: str
    prepared: float = Field(description="Share of the recording that has been estimated; the replay plays once it is 1")
    playing: bool
    position_s: float
    duration_s: float | None = Field(description="Null until the recording has been read")
    speed: float
    grasps: list[float] = Field(description="Start times of the grasps, s")


ServerMessage = Annotated[
    Hello | State | Identification | GraspEnded | Alarm | EventMessage | ReplayState, Field(discriminator="type")
]


class JournalKind(StrEnum):
    """The subject of a journal line."""

    EVENT = "event"
    RUN = "run"
    ALARM = "alarm"
    ACKNOWLEDGED = "acknowledged"
    DELETED = "deleted"
    """A recording was moved to the bin."""
    RESTORED = "restored"
    """A recording was restored from the bin."""
    EMPTIED = "emptied"
    """A recording was permanently deleted from the bin."""
    REQUEST = "request"
    """A request for a change: requester, action, client and result."""
    ACCESS = "access"
    """A sign-in or sign-out, a change of control, or a token that was made, revoked or wrong."""
    CHAIN = "chain"
    """The journal's note about itself: where its chain begins, or that a line was cut off."""


class Result(StrEnum):
    """The result of a request."""

    DONE = "done"
    REFUSED = "refused"
    FAILED = "failed"
    """The request was permitted, but could not be carried out."""


class FileCondition(StrEnum):
    """The completeness of a recording."""

    COMPLETE = "complete"
    RECOVERED = "recovered"
    """The recording was cut off, and has been repaired."""
    CUT_OFF = "cut off"


class FileRecord(WireModel):
    """A recording as the index knows it. A value that is missing or unreadable is null."""

    name: str
    run_id: str | None
    size_bytes: int
    made_at: str = Field(description="ISO 8601, UTC")
    duration_s: float | None
    samples: int | None
    lost_samples: int | None
    format_version: str | None
    condition: FileCondition | None
    problem: str | None
    deleted_at: str | None = Field(default=None, description="ISO 8601, UTC; null: not deleted")
    deleted_by: str | None = None


class JournalEntry(WireModel):
    """A line of the journal: what happened, who did it, and the full run, alarm or recording that it is about."""

    at: str = Field(description="ISO 8601, UTC")
    kind: JournalKind
    text: str
    by: str | None = None
    priority: Priority | None = None
    value: float | None = None
    limit: float | None = None
    unit: str | None = None
    run: Run | None = Field(default=None, description="The run at that time")
    alarm: Alarm | None = Field(default=None, description="The alarm at that time")
    file: FileRecord | None = Field(default=None, description="The recording that was deleted or restored")
    action: str | None = Field(default=None, description="Requested action: the name of the route or of the command")
    client: str | None = Field(default=None, description="Address that the request came from")
    result: Result | None = None
    reason: str | None = Field(default=None, description="Why the request was refused or failed")
    chain: str | None = Field(default=None, description="Chain of the line; null, as all below: it is in none")
    number: int | None = Field(default=None, description="One more than the number of the line before")
    after: str | None = Field(default=None, description="Hash of the line before")
    begins: str | None = Field(default=None, description="The chain begins here: hash of everything before in the file")
    torn: str | None = Field(default=None, description="Hash of the cut-off line before this one, if there is one")
    hash: str | None = Field(default=None, description="SHA-256 of the line up to here, hexadecimal")

    def to_line(self) -> str:
        """Return the entry as a journal line. Null fields are omitted, except within run, alarm and file."""
        return self.model_dump_json(exclude={name for name in type(self).model_fields if getattr(self, name) is None})

    def without_chain(self) -> Self:
        """Return a copy without the fields of the chain."""
        return self.model_copy(update=dict.fromkeys(CHAIN_FIELDS))


CHAIN_FIELDS = ("chain", "number", "after", "begins", "torn", "hash")


class JournalCheck(WireModel):
    """The result of a check that the journal is as it was written."""

    whole: bool = Field(description="No line was changed, removed or inserted, as far as the check can tell")
    problem: str | None = Field(description="First place that is not as it was written, and the error there")
    notes: list[str] = Field(description="Remarks that are no problem, such as a cut-off line")
    lines: int = Field(description="Lines in the chain")
    unchained: int = Field(description="Lines of an older version before the chain, which no hash protects")
    newest: int | None = Field(description="Number of the newest line")
    newest_hash: str | None = Field(description="Hash of that line: a kept copy shows later whether it was changed")
    checked_at: str = Field(description="ISO 8601, UTC")


class RecordingInfo(WireModel):
    """A file of the recordings folder."""

    name: str
    size_bytes: int
    modified_at: str = Field(description="ISO 8601, UTC")
    duration_s: float | None = Field(description="Null: not read yet, or unreadable")
    problem: str | None = Field(description="Why the recording cannot be replayed")
    whole: bool = Field(description="False while the recording is being written, or if it was cut off")
    run_id: str | None = Field(description="Null: the file is no recording of a run")
    protocol: str | None
    tissue: str | None = Field(description="Tissue given in the request for the run")
    by: str | None


class Recordings(WireModel):
    """The recordings folder."""

    folder: str
    recordings: list[RecordingInfo]


class BinnedRecording(WireModel):
    """A deleted recording that can be restored."""

    entry: str = Field(description="Name of the entry in the bin")
    name: str
    size_bytes: int
    deleted_at: str = Field(description="ISO 8601, UTC")
    deleted_by: str | None
    expires_at: str = Field(description="ISO 8601, UTC; soon after that the recording is permanently deleted")


class BinContent(WireModel):
    """The content of the bin, last deleted first. It takes disk space until the bin is emptied."""

    recordings: list[BinnedRecording]
    size_bytes: int
    keep_days: float


class Emptied(WireModel):
    """The result of emptying the bin, which deletes permanently."""

    removed: int
    freed_bytes: int


class ReportProgress(WireModel):
    """The progress of a report that is being made."""

    done: float = Field(description="Finished share of the work, 0 to 1")


class StudyInfo(WireModel):
    """A study that can be carried out."""

    name: str
    title: str
    grasps: int | None = Field(description="Usual number of grasps (or seeds) of each case")
    most_grasps: int


class StudyRequest(WireModel):
    """Start a study; one at a time."""

    study: str = Field(description="Name of a study, see GET /api/studies")
    grasps: Annotated[int, Field(ge=1, le=100_000)] | None = Field(default=None, description="Null: the usual number")
    seed: Annotated[int, Field(ge=0)] = 0
    by: PersonName | None = None


class StudyState(StrEnum):
    RUNNING = "running"
    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"


class StudyRun(WireModel):
    """A study that is under way or over."""

    id: str
    study: str
    title: str
    grasps: int
    seed: int
    by: str | None
    state: StudyState
    done: int
    of: int | None = Field(description="Number of cases; null until the study has counted them")
    started_at: str
    ended_at: str | None
    why: str | None = Field(description="Why the study was stopped or failed")
    report: str | None = Field(description="Address of the study's page; null: there is none yet")


class Studies(WireModel):
    """The available studies, and those carried out, newest first."""

    folder: str
    available: list[StudyInfo]
    runs: list[StudyRun]


class System(WireModel):
    """The versions, machine, workers and configuration of the service."""

    versions: dict[str, str]
    machine: str
    started_at: str
    workers: dict[str, str]
    realtime: dict[str, str] = Field(description="Real-time priority that each process got (`[realtime]`)")
    data_folder: str
    free_disk_bytes: int | None
    tool: dict[str, Any] = Field(description="Content of the tool file")
    constants: list[ConstantInfo] = Field(description="Calibrated constants, each with its date and expiry")
    force_scale: ForceScaleInfo
    settings: dict[str, Any] = Field(description="The settings in use")


class CalibrationKind(StrEnum):
    """The kind of a calibration."""

    TARE = "tare"
    STRAIN = "strain"
    FORCE = "force"
    STRETCH = "stretch"
    GEOMETRY = "geometry"


class CalibrationRequest(WireModel):
    """Begin a calibration of the tool, without tissue."""

    what: CalibrationKind
    values: Annotated[list[Annotated[float, Field(ge=0, le=1000)]], Field(max_length=50)] = Field(
        default_factory=list,
        description="Pulls on the handle, N (strain), forces on a load cell between the jaws, N (force), or gauge "
        "blocks between the jaws, mm (geometry)",
    )
    person: Annotated[str, Field(max_length=60)] | None = None
    valid_days: Annotated[int, Field(ge=1, le=3650)] = 90
    load_cell_error: Annotated[float, Field(ge=0, le=0.2)] = Field(
        default=0.01, description="Error of the load cell as a share of its reading (force). It widens the interval"
    )


class CalibrationReading(WireModel):
    """One reading: its weight or gauge block, and the mean signals; in motion, relative to rest and open jaws."""

    value: float
    strain_v: float
    encoder_deg: float


class Constant(WireModel):
    """A constant of the tool file as measured, with its 95 % confidence interval."""

    key: str
    value: float
    low: float
    high: float
    unit: str
    residual: float = Field(description="RMS of the residuals of the fit")
    residual_unit: str
    readings: int
    before: float | None


class CalibrationResult(WireModel):
    """The fitted constants, the tool file that holds them, and the plot."""

    file: str
    constants: list[Constant]
    remarks: list[str]
    axes: list[str]
    x: list[float]
    y: list[float]
    line_x: list[float]
    line_y: list[float]


class Calibration(WireModel):
    """The calibration under way, or the last one."""

    what: CalibrationKind | None
    values: list[float] = Field(description="Values of all readings, in order")
    readings: list[CalibrationReading]
    reading: bool = Field(description="Whether a reading is being taken")
    problem: str | None = Field(description="Why the last reading or the fit was refused")
    result: CalibrationResult | None


class SignIn(WireModel):
    """Sign a browser in."""

    token: Annotated[str, Field(min_length=1, max_length=200)]


class SessionInfo(WireModel):
    """The person who sends the request."""

    needed: bool = Field(description="Whether tokens are needed; if not, every user of this computer is admin")
    name: str | None = Field(description="Null: not signed in, or the service has no tokens")
    role: Role | None = Field(description="Null: not signed in")


class ControlRequest(WireModel):
    """Take control of the tool."""

    take_over: bool = Field(default=False, description="Take control even if another person has it")


class ControlInfo(WireModel):
    """Control of the tool: the only operator who may start a run."""

    holder: str | None = Field(description="Null: control is free, and the next start acquires it")
    expires_in_s: float = Field(description="Time until control expires, unless the holder acts")


class StopAnswer(WireModel):
    """The effect of a stop."""

    stopped: bool = Field(description="Whether a run was stopped. The motor is at zero either way")
    run: Run | None


class Health(WireModel):
    """The health of the service. A request that lacks a needed sign-in receives only the status."""

    status: Literal["ready", "starting", "faulted"]
    version: str | None
    workers: dict[str, str]
    detail: str


class Problem(WireModel):
    """RFC 9457 problem details, `application/problem+json`."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    errors: list[dict[str, str]] | None = Field(
        default=None, description="For status 422: each wrong field and the reason"
    )
