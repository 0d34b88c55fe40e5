"""Messages about the service itself, and the form of an error."""

from typing import Any, Literal

from pydantic import Field

from app.messages.base import Message
from app.messages.runs import Run
from app.messages.tool import ConstantInfo, ForceScaleInfo


class System(Message):
    """The versions, machine, workers and configuration of the service."""

    versions: dict[str, str]
    machine: str
    started_at: str
    workers: dict[str, str]
    realtime: dict[str, str] = Field(description="Real-time priority that each process got (`[realtime]`)")
    data_folder: str
    free_disk_bytes: int | None
    tool: dict[str, Any] = Field(description="Content of the tool file")
    constants: list[ConstantInfo] = Field(description="Calibrated constants, each with its date and expiry")
    force_scale: ForceScaleInfo
    settings: dict[str, Any] = Field(description="The settings in use")


class Health(Message):
    """The health of the service. A request that lacks a needed sign-in receives only the status."""

    status: Literal["ready", "starting", "faulted"]
    version: str | None
    workers: dict[str, str]
    detail: str


class Problem(Message):
    """RFC 9457 problem details, `application/problem+json`."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    errors: list[dict[str, str]] | None = Field(
        default=None, description="For status 422: each wrong field and the reason"
    )
    run: Run | None = Field(default=None, description="For status 409: the run under way, if that is why")
