"""Messages about laboratory sessions: who is examined, by whom, and under which conditions."""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from app.messages.base import EventNumber, PersonName, Record, Request

ShortText = Annotated[str, Field(max_length=100)]


class SpecimenCondition(StrEnum):
    """The condition of what is grasped."""

    IN_VIVO = "in vivo"
    IN_SITU = "in situ"
    EX_VIVO = "ex vivo"
    PHANTOM = "phantom"
    SIMULATED = "simulated"


class LabSession(Record):
    """A laboratory session, to which runs belong. The record with the highest version counts."""

    type: Literal["lab_session"] = "lab_session"
    number: EventNumber = None
    id: str
    subject: str = Field(description="Code of the subject, never a name; `[laboratory] subject_pattern` says its form")
    species: str | None
    specimen: str | None
    condition: SpecimenCondition
    operator: str | None
    protocol_number: str | None = Field(description="Number of the study's protocol, such as that of an ethics board")
    notes: str | None
    fields: dict[str, str] = Field(description="The laboratory's own fields, see `[laboratory] fields`")
    began_at: str = Field(description="ISO 8601, UTC")
    ended_at: str | None = Field(description="ISO 8601, UTC; null: it goes on")
    version: int = Field(description="1, and one more with each change")
    by: str | None = Field(description="Person who began or last changed it")


class LabSessionRequest(Request):
    """Request that begins a laboratory session, which ends the one before."""

    subject: Annotated[str, Field(min_length=1, max_length=40)]
    species: ShortText | None = None
    specimen: ShortText | None = None
    condition: SpecimenCondition
    operator: PersonName | None = None
    protocol_number: ShortText | None = None
    notes: Annotated[str, Field(max_length=2000)] | None = None
    fields: Annotated[dict[str, ShortText], Field(max_length=20)] = Field(default_factory=dict)
    by: PersonName | None = None


class LabSessionChange(LabSessionRequest):
    """Request that changes a laboratory session, under way or ended."""

    version: Annotated[int, Field(ge=1)] = Field(description="Version that is changed")
