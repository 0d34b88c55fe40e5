"""The live stream: WebSocket messages, and the binary sample frame.

`/api/live` sends one `Hello`, then JSON messages and binary sample frames. For a slow viewer, it drops the
oldest frames, but never a message. A viewer answers each frame with `FrameReceived`.
`/api/recordings/{name}/replay` sends the same for a recording, and a `ReplayState` at every change and ten times a
second. It obeys `ReplayControl`; after a jump it begins again with a `Hello`.

Events (`EventMessage`, `Alarm`, `GraspEnded`, `GraspTruth`, `Mark`, `LabSession`) are numbered in the order in which
they are sent.
`/api/live?after=NUMBER` goes on after an event: `Hello`, `State`, every event after it, then the alarms that are on.
The service keeps the last 1,000 events; if it does not have all of them, `Hello.resumed` is false and the stream
begins anew.

Binary frame, little-endian: `FRAME_HEADER`, then `columns` float32 columns of `rows` values each, in the order of
`Hello.channels`; NaN means "no value". Rows are consecutive ticks (1 tick = 1 sample) beginning at `first_tick`.

The dashboard's TypeScript types are generated from these messages and the REST bodies (`make wire`).
"""

import struct
from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from acquisition.safety_state_machine import Safety
from app.messages.alarms import Alarm
from app.messages.annotations import NO_STATEMENT, GraspTruth, Mark, TruthStatement
from app.messages.base import SCHEMA_VERSION, EventNumber, Message, Request
from app.messages.grasps import GraspEnded, Identification
from app.messages.lab_sessions import LabSession
from app.messages.runs import Run
from app.messages.tool import HoldableInfo, LibraryInfo, ToolInfo

# magic, kind, stride (reserved, 1), columns, rows, sequence, first_tick, newest_ms
FRAME_HEADER = struct.Struct("<4sBBHIIdd")


FRAME_MAGIC = b"GWF1"


class FrameKind(StrEnum):
    """The kind of a frame: new samples, or the last seconds before the viewer connected. On the wire: 0 and 1."""

    LIVE = "live"
    HISTORY = "history"


FRAME_KINDS = {FrameKind.LIVE: 0, FrameKind.HISTORY: 1}


class Phase(StrEnum):
    """What the service is doing."""

    STARTING = "starting"
    IDLE = "idle"
    RUNNING = "running"
    REPLAY = "replay"
    """The service has no tool and only shows recordings."""
    FAULTED = "faulted"


class ChannelInfo(Message):
    """One column of the sample frames."""

    name: str
    unit: str
    tissue: str | None = None


class Hello(Message):
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
    lab_fields: list[str] = Field(default=[], description="The laboratory's own fields of a session")
    resumed: bool | None = Field(
        default=None,
        description="Whether the stream goes on after the event that the viewer named (`after`); false: the service no "
        "longer has all events since, and the stream begins anew; null: the viewer named none",
    )


class RecordingState(Message):
    """The state of the recorder."""

    enabled: bool
    file: str | None = Field(description="File being written; null: no run is under way, or it is not recorded")
    samples: int = Field(description="Samples in that file so far, including those before the run")
    missing_blocks: int = Field(description="Blocks that never reached the recorder")
    problem: str | None = Field(description="Why the last recording ended before its run did")


RECORDER_OFF = RecordingState(enabled=False, file=None, samples=0, missing_blocks=0, problem=None)


class ReferenceState(Message):
    """State of the day's reference grasp on empty jaws, which makes grasps of different days comparable."""

    taken_at: str | None = Field(description="Time of the reference grasp in use, ISO 8601; null: the day has none")
    stall_v: float | None = Field(description="Strain over rest at which the drive stalls on empty jaws, V")
    declined: bool = Field(description="Whether a person went on without one today, so that the stall counts less")
    wanted: bool = Field(
        description="Whether the page asks for one before the next run: the tool is real, its library learned, and the "
        "day has none"
    )
    problem: str | None = Field(description="Why the last reference grasp could not be used, and what to do")


NO_REFERENCE = ReferenceState(taken_at=None, stall_v=None, declined=False, wanted=False, problem=None)


class State(Message):
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
    reference: ReferenceState = Field(default=NO_REFERENCE, description="The day's reference grasp")
    stated: TruthStatement = Field(
        default=NO_STATEMENT, description="What a person says that the jaws hold, for the grasp under way or the next"
    )
    session: LabSession | None = Field(default=None, description="Laboratory session under way")
    free_disk_bytes: int | None = Field(description="Null: the data folder is missing")
    faults: list[str]
    event_number: int | None = Field(
        default=None, description="Number of the newest event before this state; null before the first events are sent"
    )


class EventMessage(Message):
    """A line for the log, such as a start, a stop, a refusal, a loss, or the withdrawal of a tissue's name."""

    type: Literal["event"] = "event"
    number: EventNumber = None
    server_time_ms: float
    text: str


class FrameReceived(Request):
    """A viewer's answer to a sample frame. Without answers, the server stops sending frames after a few."""

    type: Literal["received"] = "received"
    sequence: int


class ReplayControl(Request):
    """A viewer's command to a replay; null leaves a value unchanged."""

    type: Literal["replay"] = "replay"
    playing: bool | None = None
    position_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    speed: Annotated[float, Field(ge=0.25, le=10)] | None = None


class ReplayState(Message):
    """The state of a replay."""

    type: Literal["replay_state"] = "replay_state"
    name: str
    prepared: float = Field(description="Share of the recording that has been estimated; the replay plays once it is 1")
    playing: bool
    position_s: float
    duration_s: float | None = Field(description="Null until the recording has been read")
    speed: float
    grasps: list[float] = Field(description="Start times of the grasps, s")
    start_s: float = Field(default=0.0, description="Time of position 0 by the clock of the run's marks, s")


StreamEvent = EventMessage | Alarm | GraspEnded | GraspTruth | Mark | LabSession
"""A message with a number, after which the stream can go on."""

ServerMessage = Annotated[
    Hello | State | Identification | GraspEnded | GraspTruth | Mark | LabSession | Alarm | EventMessage | ReplayState,
    Field(discriminator="type"),
]
