"""Messages about grasps: the answer for the one under way, and a finished one."""

from typing import Literal, Self

from pydantic import Field

from app.messages.base import EventNumber, Record
from estimator.estimate_block import GraspRecord, IdentificationResult
from estimator.force_alarms import Priority


class Identification(IdentificationResult, Record):
    """The answer for the grasp under way, sent at every change and ten times a second during a grasp."""

    type: Literal["identification"] = "identification"
    server_time_ms: float

    @classmethod
    def from_result(cls, result: IdentificationResult, server_time_ms: float) -> Self:
        return cls(**dict(result), server_time_ms=server_time_ms)


class Grasp(GraspRecord, Record):
    """A finished grasp. A field without a value is null."""

    alarms: list[Priority] = Field(description="Force warnings during the grasp: the highest of each rise of the force")

    @classmethod
    def from_record(cls, record: GraspRecord, alarms: list[Priority]) -> Self:
        return cls(**dict(record), alarms=alarms)


class GraspEnded(Record):
    """Message that a grasp has ended, with its record."""

    type: Literal["grasp"] = "grasp"
    number: EventNumber = None
    run_id: str | None
    grasp: Grasp
