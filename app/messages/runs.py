"""Messages about runs: a run and its state, and the requests that start and stop one."""

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


class RunRequest(Request):
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


class StopRequest(Request):
    """Stop the motor. The body is optional."""

    by: PersonName | None = None


class SpotRequest(Request):
    """Begin a new spot. The body is optional."""

    by: PersonName | None = None


class StopAnswer(Message):
    """The effect of a stop."""

    stopped: bool = Field(description="Whether a run was stopped. The motor is at zero either way")
    run: Run | None
