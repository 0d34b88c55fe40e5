"""Messages about people: roles, sign-in, and control of the tool."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from app.messages.base import Message, Request


class Role(StrEnum):
    """The permissions of a token; each role includes the roles before it."""

    VIEWER = "viewer"
    """May watch and press STOP."""
    OPERATOR = "operator"
    """May run protocols and acknowledge alarms."""
    ADMIN = "admin"
    """May delete recordings."""

    def includes(self, other: "Role") -> bool:
        order = list(Role)
        return order.index(self) >= order.index(other)


class SignIn(Request):
    """Request to sign a browser in."""

    token: Annotated[str, Field(min_length=1, max_length=200)]


class SessionInfo(Message):
    """The person who sends the request, with the role."""

    needed: bool = Field(description="Whether tokens are needed; if not, every user of this computer is admin")
    name: str | None = Field(description="Null: not signed in, or the service has no tokens")
    role: Role | None = Field(description="Null: not signed in")


class ControlRequest(Request):
    """Request to take control of the tool."""

    take_over: bool = Field(default=False, description="Take control even if another person has it")


class ControlInfo(Message):
    """Control of the tool: which operator, as the only one, may start a run."""

    holder: str | None = Field(description="Null: control is free, and the next start acquires it")
    expires_in_s: float = Field(description="Time until control expires, unless the holder acts")
