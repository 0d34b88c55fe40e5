"""The base classes of all messages between the service, its clients and its files, and the version of what is sent.

A field is added with a default that says what its absence means. A reader ignores a field that it does not know. So
what is sent or stored may grow, while older clients read newer messages, and newer programs read older files.
`docs/programs.md` says which changes raise a version.
"""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

SCHEMA_VERSION = 4
"""The version of REST bodies and live stream; raised when a field is removed, retyped or given another meaning."""

PersonName = Annotated[str, Field(min_length=1, max_length=40, pattern=r"\S")]
EventNumber = Annotated[
    int | None, Field(description="Number in the live stream, one more than that of the event before; elsewhere null")
]
Reason = Annotated[str, Field(min_length=3, max_length=300, pattern=r"\S")]


class Message(BaseModel):
    """Base of what the service sends: an answer, or a message of the live stream."""

    model_config = ConfigDict(extra="ignore", frozen=True, ser_json_inf_nan="null")


class Record(Message):
    """Base of messages that are also stored: in the index, a recording, a journal line or a study's folder.

    `app/messages/stored.py` reads it back, also as an older or newer version wrote it.
    """


class Request(BaseModel):
    """Base of what a client sends. An unknown field is an error: it may be a misspelled one."""

    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="null")
