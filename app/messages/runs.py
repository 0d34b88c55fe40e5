"""Messages about runs, each one playing of a protocol: the run and its state, and requests to start and stop it."""

from enum import StrEnum
from typing import Annotated

from pydantic import ConfigDict, Field

from app.messages.base import Message, PersonName, Reason, Record, Request
from app.messages.tool import UNMEASURED_SCALE_DESCRIPTION


class RunState(StrEnum):
    RUNNING = "running"
    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"


class Run(Record):
    """A run: one playing of a protocol, with its state."""

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
    session: str | None = Field(default=None, description="Laboratory session that it belongs to")


class RunRequest(Request):
    """Request to start a run of a protocol."""

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


class StopRequest(Request):
    """Request to stop the motor. The body is optional."""

    by: PersonName | None = None


class SpotRequest(Request):
    """Request to begin a new spot. The body is optional."""

    by: PersonName | None = None


class DeclineRequest(Request):
    """Go on without a reference grasp today. The body is optional."""

    by: PersonName | None = None


class StopAnswer(Message):
    """Answer to a stop: whether it ended a run, and which."""

    stopped: bool = Field(description="Whether a run was stopped. The motor is at zero either way")
    run: Run | None
