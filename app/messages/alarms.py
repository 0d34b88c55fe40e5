"""Messages about alarms."""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from app.messages.base import EventNumber, PersonName, Record, Request
from estimator.force_alarms import Priority


class AlarmKind(StrEnum):
    FORCE = "force"
    TECHNICAL = "technical"


class Alarm(Record):
    """An alarm began, changed or ended. It keeps its `id` until it is neither `active` nor `latched`."""

    type: Literal["alarm"] = "alarm"
    number: EventNumber = None
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


class AcknowledgeRequest(Request):
    """Request to acknowledge an alarm that a person has seen."""

    by: PersonName | None = Field(
        default=None, description="Name of the person; optional for a person who is signed in"
    )
    priority: Priority = Field(description="Priority that the person saw; refused if the alarm is worse now")
