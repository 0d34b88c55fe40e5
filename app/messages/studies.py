"""Messages about studies, which measure the estimator's accuracy: the available ones, requests and runs."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from app.messages.base import Message, PersonName, Record, Request


class StudyInfo(Message):
    """A study that can be carried out."""

    name: str
    title: str
    grasps: int | None = Field(description="Usual number of grasps (or seeds) of each case")
    most_grasps: int


class StudyRequest(Request):
    """Request to start a study; one runs at a time."""

    study: str = Field(description="Name of a study, see GET /api/studies")
    grasps: Annotated[int, Field(ge=1, le=100_000)] | None = Field(default=None, description="Null: the usual number")
    seed: Annotated[int, Field(ge=0)] = 0
    by: PersonName | None = None


class StudyState(StrEnum):
    RUNNING = "running"
    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"


class StudyRun(Record):
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


class Studies(Message):
    """The available studies, and those carried out, newest first."""

    folder: str
    available: list[StudyInfo]
    runs: list[StudyRun]
