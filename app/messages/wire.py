"""The whole contract with browsers and programs: WebSocket messages, REST bodies, and the binary sample frame.

`/api/live` sends one `Hello`, then JSON messages (never dropped) and binary sample frames (the oldest are dropped
for a viewer that is slow). A viewer answers each frame with `FrameReceived`. TypeScript types are generated from here.
`/api/recordings/{name}/replay` sends the same of a recording, with a `ReplayState` at every change and ten times a
second, and obeys `ReplayControl`; after a jump it begins again with a `Hello`.

Binary frame, little-endian: `FRAME_HEADER`, then `columns` float32 columns of `rows` values each, in the order of
`Hello.channels`; NaN means "no value". Rows are consecutive ticks (1 tick = 1 sample) beginning at `first_tick`.
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
    """How a frame came: as it happened, or the last seconds on connecting. On the wire: 0 and 1."""

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
    """Where the tool stands."""

    STARTING = "starting"
    IDLE = "idle"
    RUNNING = "running"
    REPLAY = "replay"
    """There is no tool, only recordings."""
    FAULTED = "faulted"


class RunState(StrEnum):
    RUNNING = "running"
    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"


class Role(StrEnum):
    """What somebody may do: each as much as those before, and more."""

    VIEWER = "viewer"
    """Watches, and presses STOP."""
    OPERATOR = "operator"
    """Runs protocols and acknowledges alarms."""
    ADMIN = "admin"
    """Deletes recordings."""

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
    """Something that the simulated grasper can be told to hold."""

    name: str
    title: str
    in_library: bool


class SpreadInfo(WireModel):
    """Standard deviations of natural logarithms from specimen to specimen."""

    log_alpha: float
    log_beta: float
    log_damping: float
    log_thickness: float


class TissueInfo(WireModel):
    """A profile of the library in use."""

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
    """By which scale newtons are told: jaw force is Eq. (2) times `value`; it may be anything from `low` to `high`."""

    value: float
    low: float
    high: float
    measured: bool
    source: str
    date: str | None
    expires: str | None
    text: str = Field(description="The same in words, to stand beside newtons")


class ConstantInfo(WireModel):
    """When a constant of the tool file was measured."""

    constant: str = Field(description="Its key in the tool file")
    value: float
    date: str
    by: str = Field(description="Who measured it, or where it comes from")
    expires: str | None = Field(description="From this day on it is to be measured anew; null: not said")
    expired: bool


class ToolInfo(WireModel):
    name: str
    title: str
    kind: ToolKind
    sample_rate_hz: float
    max_command_v: float
    force_ceiling_n: float
    force_scale: ForceScaleInfo
    calibration_date: str = Field(description="Of the constants that have no date of their own")
    calibrated_by: str


class ProtocolInfo(WireModel):
    """A protocol with its waveform: motor command over one cycle, for a preview."""

    name: str
    title: str
    cycles: int
    cycle_s: float
    peak_command_v: float
    refused: str | None = Field(description="Why this tool cannot play it; its waveform is then empty")
    time_s: list[float]
    command_v: list[float]


class RunRequest(WireModel):
    """Start a protocol."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"protocol": "trapezoid_2hz", "cycles": 3, "tissue": "liver"}]}
    )

    protocol: str = Field(description="Name of a protocol, see GET /api/protocols")
    cycles: Annotated[int, Field(ge=1, le=10_000)] | None = Field(None, description="Grasps; null: the protocol's")
    tissue: str | None = Field(None, description="What the simulated grasper holds; refused for a real tool")
    by: PersonName | None = Field(None, description="Who asks for it")
    unmeasured_scale: Reason | None = Field(None, description=UNMEASURED_SCALE_DESCRIPTION)


class ArmRequest(WireModel):
    """May be left out altogether."""

    by: PersonName | None = None
    unmeasured_scale: Reason | None = Field(None, description=UNMEASURED_SCALE_DESCRIPTION)


class SafetyReport(WireModel):
    """Where the tool stands after it was armed or disarmed."""

    safety: Safety


class StopRequest(WireModel):
    """May be left out altogether: a stop needs no words."""

    by: PersonName | None = None


class Run(WireModel):
    """One run of a protocol."""

    id: str
    protocol: str
    cycles: int
    tissue: str | None
    by: str | None = Field(description="Who started it")
    state: RunState
    started_at: str
    ended_at: str | None
    why: str | None = Field(description="Why it stopped or failed")
    grasps: int


class Grasp(WireModel):
    """A finished grasp. Null where there is no value."""

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
    alarms: list[Priority] = Field(description="Force warnings during it, the highest of each rise")
    held_back: bool = Field(description="Whether the limiter held the motor back")
    peak_share_of_limit: float | None = Field(
        None, description="Highest share of the force in the limit that was enforced meanwhile; null: none was"
    )


class Hello(WireModel):
    """First message on a connection."""

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
    """How it stands with the recorder."""

    enabled: bool
    file: str | None = Field(description="What is being written; null: no run is under way, or none is recorded")
    samples: int = Field(description="In that file so far, those from before the run included")
    missing_blocks: int = Field(description="Blocks that never reached the recorder")
    problem: str | None = Field(description="Why the last recording ended before its run")


RECORDER_OFF = RecordingState(enabled=False, file=None, samples=0, missing_blocks=0, problem=None)


class State(WireModel):
    """Where everything stands; once a second and at every change."""

    type: Literal["state"] = "state"
    server_time_ms: float
    phase: Phase
    safety: Safety = Field(description="Whether the motor may move; it does only in `running` and `holding back`")
    safety_why: str | None = Field(description="Why it is faulted, or was not armed")
    run: Run | None
    last_run: Run | None
    limit_n: float | None = Field(description="Limit that the limiter enforces now, N; null: nothing does")
    simulated_tissue: str | None
    demo: str | None = Field(description="What the demonstration is showing; null when there is none")
    control: str | None = Field(description="Who holds the tool: who has control, else who started the run under way")
    rate_hz: float
    lost_samples: int
    estimator_latency_ms: float | None
    viewers: int
    recording: RecordingState
    free_disk_bytes: int | None = Field(description="Null: the data folder is gone")
    faults: list[str]


class Identification(WireModel):
    """What is held: at every change, and ten times a second during a grasp."""

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
    threshold_n: float = Field(description="Injury threshold by which force alarms are judged; no limit of the motor")
    threshold_tissue: str | None = Field(description="Whose threshold; null: the lowest of the library")
    limit_n: float | None = Field(description="Limit that the limiter enforces, as it says itself; null: nothing does")
    holding_back: bool = Field(description="Whether the limiter is holding the motor back")
    time_to_limit_s: float | None = Field(description="Until the limit is reached, while the force rises; else null")
    thickness_m: float | None = Field(description="Of what is held, where the tool can measure it at contact")
    convergence_s: dict[str, float | None]
    force_error_n: dict[str, float | None]


class GraspEnded(WireModel):
    type: Literal["grasp"] = "grasp"
    run_id: str | None
    grasp: Grasp


class Alarm(WireModel):
    """An alarm began, changed or ended. The same `id` until it is over: neither `active` nor `latched`."""

    type: Literal["alarm"] = "alarm"
    id: str
    kind: AlarmKind
    priority: Priority
    active: bool = Field(description="Whether its cause is there")
    latched: bool = Field(description="Whether it stays until somebody has acknowledged it")
    text: str
    value: float | None = Field(description="What passed the limit; after that the highest so far")
    limit: float | None = Field(description="What it is judged against: of force alarms the injury threshold")
    unit: str | None
    began_ms: float
    ended_ms: float | None = Field(description="When its cause went away")
    acknowledged_by: str | None = Field(description="Null: nobody has yet, or it became worse since")
    change: Annotated[int, Field(ge=1)] = Field(1, description="One more each time it is told: the highest is newest")


class AcknowledgeRequest(WireModel):
    """Somebody has seen an alarm."""

    by: PersonName | None = Field(None, description="Who has; whoever is signed in may leave it out")
    priority: Priority = Field(description="What was seen; refused if the alarm is worse by now")


class EventMessage(WireModel):
    """Something worth a line in the log: started, stopped, refused, lost, a tissue's name withdrawn."""

    type: Literal["event"] = "event"
    server_time_ms: float
    text: str


class FrameReceived(WireModel):
    """A viewer's answer to a sample frame; without answers the server stops sending frames after a few."""

    type: Literal["received"] = "received"
    sequence: int


class ReplayControl(WireModel):
    """What a viewer of a replay asks for; null: as it is."""

    type: Literal["replay"] = "replay"
    playing: bool | None = None
    position_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    speed: Annotated[float, Field(ge=0.25, le=10)] | None = None


class ReplayState(WireModel):
    """Where a replay stands."""

    type: Literal["replay_state"] = "replay_state"
    name: str
    prepared: float = Field(description="Share of the recording that has been estimated; it plays from 1 on")
    playing: bool
    position_s: float
    duration_s: float | None = Field(description="Null until it has been read")
    speed: float
    grasps: list[float] = Field(description="When its grasps begin, s")


ServerMessage = Annotated[
    Hello | State | Identification | GraspEnded | Alarm | EventMessage | ReplayState, Field(discriminator="type")
]


class JournalKind(StrEnum):
    """What a line of the journal is about."""

    EVENT = "event"
    RUN = "run"
    ALARM = "alarm"
    ACKNOWLEDGED = "acknowledged"
    DELETED = "deleted"
    """A recording went to the bin."""
    RESTORED = "restored"
    """A recording came back from the bin."""
    EMPTIED = "emptied"
    """A recording was removed from the bin, for good."""
    REQUEST = "request"
    """Somebody asked for a change: who, what, from where, and what came of it."""
    ACCESS = "access"
    """Somebody signed in or out, took or gave back control, or a token was made, taken back or wrong."""
    CHAIN = "chain"
    """The journal says something of itself: where its chain begins, or a line was cut off."""


class Result(StrEnum):
    """What came of a request."""

    DONE = "done"
    REFUSED = "refused"
    FAILED = "failed"
    """It could not be carried out."""


class FileCondition(StrEnum):
    """How a recording ends."""

    COMPLETE = "complete"
    RECOVERED = "recovered"
    """It was cut off, and put in order since."""
    CUT_OFF = "cut off"


class FileRecord(WireModel):
    """A recording as the index knows it. Null where it could not be read, or nobody says."""

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
    deleted_at: str | None = Field(None, description="Null: it is there")
    deleted_by: str | None = None


class JournalEntry(WireModel):
    """A line of the journal: what happened, and who did it; and whole, what it is about."""

    at: str = Field(description="ISO 8601, UTC")
    kind: JournalKind
    text: str
    by: str | None = None
    priority: Priority | None = None
    value: float | None = None
    limit: float | None = None
    unit: str | None = None
    run: Run | None = Field(None, description="As it was then")
    alarm: Alarm | None = Field(None, description="As it was then")
    file: FileRecord | None = Field(None, description="The recording that was deleted or restored")
    action: str | None = Field(None, description="What was asked for: the name of the route or of the command")
    client: str | None = Field(None, description="From where it was asked for")
    result: Result | None = None
    reason: str | None = Field(None, description="Why it was refused, or failed")
    chain: str | None = Field(None, description="Which chain the line belongs to; null, as all below: to none")
    number: int | None = Field(None, description="One more than the line before")
    after: str | None = Field(None, description="Hash of the line before")
    begins: str | None = Field(None, description="Here the chain begins: hash of all that stands in the file before")
    torn: str | None = Field(None, description="A cut-off line stands before this one: its hash")
    hash: str | None = Field(None, description="SHA-256 of the line up to here, hexadecimal")

    def to_line(self) -> str:
        """As it stands in the journal: without what is null, except within what it is about."""
        return self.model_dump_json(exclude={name for name in type(self).model_fields if getattr(self, name) is None})

    def without_chain(self) -> Self:
        """What it says, without its place in the journal."""
        return self.model_copy(update=dict.fromkeys(CHAIN_FIELDS))


CHAIN_FIELDS = ("chain", "number", "after", "begins", "torn", "hash")


class JournalCheck(WireModel):
    """Whether the journal is as it was written."""

    whole: bool = Field(description="Nothing was changed, removed or put in, as far as can be known")
    problem: str | None = Field(description="The first place that is not as it was written, and what is wrong there")
    notes: list[str] = Field(description="What one should know of a journal all the same, such as a cut-off line")
    lines: int = Field(description="Lines in the chain")
    unchained: int = Field(description="Lines of an older version before it, which nothing vouches for")
    newest: int | None = Field(description="Number of the newest line")
    newest_hash: str | None = Field(description="Its hash: who keeps it can tell later whether it still stands there")
    checked_at: str = Field(description="ISO 8601, UTC")


class RecordingInfo(WireModel):
    """A file of the recordings folder."""

    name: str
    size_bytes: int
    modified_at: str = Field(description="ISO 8601, UTC")
    duration_s: float | None = Field(description="Null: not read yet, or not to be read")
    problem: str | None = Field(description="Why it cannot be replayed")
    whole: bool = Field(description="False while it is being written, and for one that was cut off")
    run_id: str | None = Field(description="Null where it is no recording of a run")
    protocol: str | None
    tissue: str | None = Field(description="What it was said to hold")
    by: str | None


class Recordings(WireModel):
    """The recordings folder."""

    folder: str
    recordings: list[RecordingInfo]


class BinnedRecording(WireModel):
    """A deleted recording that can be restored."""

    entry: str = Field(description="Its name in the bin")
    name: str
    size_bytes: int
    deleted_at: str = Field(description="ISO 8601, UTC")
    deleted_by: str | None
    expires_at: str = Field(description="ISO 8601, UTC; soon after that it is removed for good")


class BinContent(WireModel):
    """What is in the bin, deleted last first. It takes room on the disk until it is emptied."""

    recordings: list[BinnedRecording]
    size_bytes: int
    keep_days: float


class Emptied(WireModel):
    """What was removed from the bin, for good."""

    removed: int
    freed_bytes: int


class ReportProgress(WireModel):
    """A report that is being made."""

    done: float = Field(description="Share, 0 to 1")


class StudyInfo(WireModel):
    """A study that can be carried out."""

    name: str
    title: str
    grasps: int | None = Field(description="How many grasps (or seeds) of each it takes unless told otherwise")
    most_grasps: int


class StudyRequest(WireModel):
    """Start a study; one at a time."""

    study: str = Field(description="Name of a study, see GET /api/studies")
    grasps: Annotated[int, Field(ge=1, le=100_000)] | None = Field(None, description="Null: as many as usual")
    seed: Annotated[int, Field(ge=0)] = 0
    by: PersonName | None = None


class StudyState(StrEnum):
    RUNNING = "running"
    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"


class StudyRun(WireModel):
    """A study that was carried out, or is."""

    id: str
    study: str
    title: str
    grasps: int
    seed: int
    by: str | None
    state: StudyState
    done: int
    of: int | None = Field(description="Cases; null until the study has counted them")
    started_at: str
    ended_at: str | None
    why: str | None = Field(description="Why it was stopped or failed")
    report: str | None = Field(description="Address of its page, once there is one")


class Studies(WireModel):
    """What can be studied, and what has been, newest first."""

    folder: str
    available: list[StudyInfo]
    runs: list[StudyRun]


class System(WireModel):
    """What runs here, and how it is set up."""

    versions: dict[str, str]
    machine: str
    started_at: str
    workers: dict[str, str]
    realtime: dict[str, str] = Field(description="What the system granted each worker of `[realtime]`")
    data_folder: str
    free_disk_bytes: int | None
    tool: dict[str, Any] = Field(description="The tool file")
    constants: list[ConstantInfo] = Field(description="Each calibrated constant of it with its own date and expiry")
    force_scale: ForceScaleInfo
    settings: dict[str, Any] = Field(description="The settings in use")


class CalibrationKind(StrEnum):
    """What is measured."""

    TARE = "tare"
    STRAIN = "strain"
    STRETCH = "stretch"
    GEOMETRY = "geometry"


class CalibrationRequest(WireModel):
    """Begin a calibration of the tool, without tissue."""

    what: CalibrationKind
    values: Annotated[list[Annotated[float, Field(ge=0, le=1000)]], Field(max_length=50)] = Field(
        default_factory=list, description="Pulls on the handle, N (strain), or gauges between the jaws, mm (geometry)"
    )
    person: Annotated[str, Field(max_length=60)] | None = None
    valid_days: Annotated[int, Field(ge=1, le=3650)] = 90


class CalibrationReading(WireModel):
    """One reading: its weight or gauge, and the means of the signals; after motion over rest and open jaws."""

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
    residual: float = Field(description="RMS of what the fit leaves")
    residual_unit: str
    readings: int
    before: float | None


class CalibrationResult(WireModel):
    """What was fitted, the tool file it stands in, and the plot."""

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
    values: list[float] = Field(description="Of all readings in their order; the next is that after the last reading")
    readings: list[CalibrationReading]
    reading: bool = Field(description="Whether one is being taken")
    problem: str | None = Field(description="Why the last reading or the fit was refused")
    result: CalibrationResult | None


class SignIn(WireModel):
    """Sign a browser in."""

    token: Annotated[str, Field(min_length=1, max_length=200)]


class SessionInfo(WireModel):
    """Who asks."""

    needed: bool = Field(description="Whether this service has tokens; without them everybody at the machine is admin")
    name: str | None = Field(description="Null: not signed in, or without need")
    role: Role | None = Field(description="Null: not signed in")


class ControlRequest(WireModel):
    """Take control of the tool."""

    take_over: bool = Field(False, description="Also where somebody else has it")


class ControlInfo(WireModel):
    """Who has control of the tool: the only operator who may start."""

    holder: str | None = Field(description="Null: nobody; whoever starts next")
    expires_in_s: float = Field(description="Unless the holder does something meanwhile")


class StopAnswer(WireModel):
    """What a stop did."""

    stopped: bool = Field(description="Whether a run was stopped. The motor is at zero either way")
    run: Run | None


class Health(WireModel):
    """Whoever is not signed in, where that is needed, learns the status alone."""

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
    errors: list[dict[str, str]] | None = Field(None, description="For 422: each field at fault and why")
