"""Messages about what people say of a run: what the jaws held in each grasp, and marks on the recording.

The estimator never receives them.
"""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from app.messages.base import EventNumber, Message, PersonName, Reason, Record, Request
from config.tissue_names import find_name_fault


class GraspRemark(StrEnum):
    """What was peculiar about a grasp, as a person saw it."""

    EMPTY = "empty"
    SLIPPED = "slipped"
    TWO_TISSUES = "two tissues"


class GraspTruth(Record):
    """Ground truth of a grasp, as a person stated it. The record with the highest version counts."""

    type: Literal["truth"] = "truth"
    number: EventNumber = None
    run_id: str
    grasp: int = Field(description="Index of the grasp in its run")
    held: str | None = Field(description="Tissue that was held, also one that no library knows; null: not stated")
    remark: GraspRemark | None
    version: int = Field(description="1, and one more with each correction")
    by: str | None
    at: str = Field(description="Time of the statement, ISO 8601, UTC")
    why: str | None = Field(description="Reason of a correction")
    place: str | None = Field(default=None, description="Place on the organ, in the person's words")

    def describe(self) -> str:
        """Return the text of its journal line."""
        words = ", ".join(each for each in (self.held, self.place, self.remark) if each) or "not known"
        because = f" ({self.why})" if self.why else ""
        return f"Truth of grasp {self.grasp} of run {self.run_id}: {words}{because}"


class Mark(Record):
    """A mark with a text on one sample of a run. The record with the highest version counts."""

    type: Literal["mark"] = "mark"
    number: EventNumber = None
    id: str = Field(description="The run's id and the mark's number in it")
    run_id: str
    at_s: float = Field(description="Time of its sample, s since the first sample of the source, like that of grasps")
    at_ms: float = Field(description="Time of its sample by the service's clock, ms since 1970")
    uncertainty_s: float = Field(
        description="How much earlier the person may have meant it: the age of the sample, or of the newest sample if "
        "the request named none, when the service received the request. The person's own reaction comes on top"
    )
    text: str
    version: int = Field(description="1, and one more with each change")
    deleted: bool = False
    by: str | None
    changed_at: str = Field(description="Time of the request or of the last change, ISO 8601, UTC")


def _check_tissue_name(name: str) -> str:
    if fault := find_name_fault(name):
        raise ValueError(fault)
    return name


TissueName = Annotated[str, Field(max_length=100), AfterValidator(_check_tissue_name)]
MAX_PLACE_LETTERS = 80
PlaceText = Annotated[str, Field(min_length=1, max_length=MAX_PLACE_LETTERS, pattern=r"\S")]
MarkText = Annotated[str, Field(min_length=1, max_length=200, pattern=r"\S")]


class TruthStatement(Message):
    """Statement of what the jaws hold, for the grasp under way or the next one.

    `held` and `place` count for all further grasps, until the next statement, a new spot or the end of the run;
    `remark` for one.
    """

    held: str | None
    remark: GraspRemark | None
    by: str | None
    place: str | None = Field(default=None, description="Place on the organ, in the person's words")


NO_STATEMENT = TruthStatement(held=None, remark=None, by=None)


class TruthRequest(Request):
    """Request that states what the jaws hold from the grasp under way, or the next one, on."""

    held: TissueName | None = Field(
        default=None, description="Tissue, in small letters, digits and _; null: take the statement back"
    )
    remark: GraspRemark | None = Field(default=None, description="For the grasp under way or the next one alone")
    place: PlaceText | None = Field(default=None, description="Place on the organ, such as `left lobe`")
    by: PersonName | None = None


class TruthCorrection(Request):
    """Request that corrects the ground truth of a finished grasp, or states it afterwards."""

    held: TissueName | None = Field(description="Tissue, in small letters, digits and _; null: not known")
    remark: GraspRemark | None = None
    place: PlaceText | None = Field(default=None, description="Place on the organ; null: not known")
    version: Annotated[int, Field(ge=0)] = Field(
        description="Version that is corrected, 0 for none: a correction that somebody made meanwhile is not lost"
    )
    why: Reason | None = Field(default=None, description="Needed to change an earlier statement")
    by: PersonName | None = None


class MarkRequest(Request):
    """Request for a mark on the running recording."""

    text: MarkText
    tick: Annotated[int, Field(ge=0)] | None = Field(
        default=None, description="Newest sample that the person saw; null: the newest one at the service"
    )
    by: PersonName | None = None


class MarkChange(Request):
    """Request that changes the text of a mark."""

    text: MarkText
    version: Annotated[int, Field(ge=1)] = Field(description="Version that is changed")
    by: PersonName | None = None
