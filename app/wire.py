"""The whole contract with browsers and programs: WebSocket messages, REST bodies, and the binary sample frame.

`/api/live` sends one `Hello`, then JSON messages (never dropped) and binary sample frames (the oldest are dropped
for a viewer that is slow). A viewer answers each frame with `FrameReceived`. TypeScript types are generated from here.

Binary frame, little-endian: `FRAME_HEADER`, then `columns` float32 columns of `rows` values each, in the order of
`Hello.channels`; NaN means "no value". Rows are consecutive ticks (1 tick = 1 sample) beginning at `first_tick`.
"""

import struct
from enum import StrEnum
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from config.schema import ToolKind
from estimator.alarms import Priority

SCHEMA_VERSION = 1

# magic, kind, stride (reserved, 1), columns, rows, sequence, first_tick, newest_ms
FRAME_HEADER = struct.Struct("<4sBBHIIdd")
FRAME_MAGIC = b"GWF1"


class FrameKind(StrEnum):
    """How a frame came: as it happened, or the last seconds on connecting. On the wire: 0 and 1."""

    LIVE = "live"
    HISTORY = "history"


FRAME_KINDS = {FrameKind.LIVE: 0, FrameKind.HISTORY: 1}


class Wire(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="null")


class Phase(StrEnum):
    """Where the tool stands."""

    STARTING = "starting"
    IDLE = "idle"
    RUNNING = "running"
    REPLAYING = "replaying"
    ENDED = "ended"
    FAULTED = "faulted"


class RunState(StrEnum):
    RUNNING = "running"
    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"


class AlarmKind(StrEnum):
    FORCE = "force"
    TECHNICAL = "technical"


class ChannelInfo(Wire):
    """One column of the sample frames."""

    name: str
    unit: str
    tissue: str | None = None


class TissueInfo(Wire):
    """A profile of the library in use."""

    name: str
    title: str
    alpha_n: float
    beta_per_m: float
    damping_kg_per_s: float
    thickness_m: float
    threshold_n: float


class ToolInfo(Wire):
    name: str
    title: str
    kind: ToolKind
    sample_rate_hz: float
    max_command_v: float
    force_ceiling_n: float
    calibration_date: str


class ProtocolInfo(Wire):
    """A protocol with its waveform: motor command over one cycle, for a preview."""

    name: str
    title: str
    cycles: int
    cycle_s: float
    peak_command_v: float
    refused: str | None = Field(description="Why this tool cannot play it; its waveform is then empty")
    time_s: list[float]
    command_v: list[float]


class RunRequest(Wire):
    """Start a protocol."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"protocol": "trapezoid_2hz", "cycles": 3, "tissue": "liver"}]}
    )

    protocol: str = Field(description="Name of a protocol, see GET /api/protocols")
    cycles: Annotated[int, Field(ge=1, le=10_000)] | None = Field(None, description="Grasps; null: the protocol's")
    tissue: str | None = Field(None, description="What the simulated grasper holds; refused for a real tool")


class Run(Wire):
    """One run of a protocol."""

    id: str
    protocol: str
    cycles: int
    tissue: str | None
    state: RunState
    started_at: str
    ended_at: str | None
    why: str | None = Field(description="Why it stopped or failed")
    grasps: int


class Grasp(Wire):
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


class Hello(Wire):
    """First message on a connection."""

    type: Literal["hello"] = "hello"
    schema_version: int = SCHEMA_VERSION
    version: str
    server_time_ms: float
    tool: ToolInfo
    library: str
    tissues: list[TissueInfo]
    lowest_threshold_n: float
    warning_shares: list[float] = Field(description="Low, medium and high warning, as shares of the threshold")
    channels: list[ChannelInfo]
    frame_rate_hz: float


class State(Wire):
    """Where everything stands; once a second and at every change."""

    type: Literal["state"] = "state"
    server_time_ms: float
    phase: Phase
    run: Run | None
    last_run: Run | None
    simulated_tissue: str | None
    demo: bool
    rate_hz: float
    lost_samples: int
    estimator_latency_ms: float | None
    viewers: int
    faults: list[str]


class Identification(Wire):
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
    threshold_n: float = Field(description="Injury threshold in force")
    threshold_tissue: str | None = Field(description="Whose threshold; null: the lowest of the library")
    convergence_s: dict[str, float | None]
    force_error_n: dict[str, float | None]


class GraspEnded(Wire):
    type: Literal["grasp"] = "grasp"
    run_id: str | None
    grasp: Grasp


class Alarm(Wire):
    """An alarm began, changed or ended. The same `id` until it ends."""

    type: Literal["alarm"] = "alarm"
    id: str
    kind: AlarmKind
    priority: Priority
    active: bool
    text: str
    value: float | None
    limit: float | None
    unit: str | None
    began_ms: float


class EventMessage(Wire):
    """Something worth a line in the log: started, stopped, refused, lost, a tissue's name withdrawn."""

    type: Literal["event"] = "event"
    server_time_ms: float
    text: str


class FrameReceived(Wire):
    """A viewer's answer to a sample frame; without answers the server stops sending frames after a few."""

    type: Literal["received"] = "received"
    sequence: int


ServerMessage = Annotated[
    Hello | State | Identification | GraspEnded | Alarm | EventMessage, Field(discriminator="type")
]


class StopAnswer(Wire):
    """What a stop did."""

    stopped: bool = Field(description="Whether a run was stopped. The motor is at zero either way")
    run: Run | None


class Health(Wire):
    status: Literal["ready", "starting", "faulted"]
    version: str
    workers: dict[str, str]
    detail: str


class Problem(Wire):
    """RFC 9457 problem details, `application/problem+json`."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    errors: list[dict[str, str]] | None = Field(None, description="For 422: each field at fault and why")
