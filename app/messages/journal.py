"""Messages about the journal: its lines, and the result of its check."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Self

from pydantic import Field

from app.messages.alarms import Alarm
from app.messages.annotations import GraspTruth, Mark
from app.messages.base import Message, Record
from app.messages.lab_sessions import LabSession
from app.messages.recordings import CompletedFile, FileRecord
from app.messages.runs import Run
from estimator.force_alarms import Priority


class JournalKind(StrEnum):
    """The subject of a journal line."""

    EVENT = "event"
    RUN = "run"
    ALARM = "alarm"
    ACKNOWLEDGED = "acknowledged"
    DELETED = "deleted"
    """A recording was moved to the bin."""
    RESTORED = "restored"
    """A recording was restored from the bin."""
    EMPTIED = "emptied"
    """A recording was permanently deleted from the bin."""
    REQUEST = "request"
    """A request for a change: requester, action, client and result."""
    ACCESS = "access"
    """A sign-in or sign-out, a change of control, or a token that was made, revoked or wrong."""
    TRUTH = "truth"
    """What a person says that was held in a grasp, or a correction of it."""
    MARK = "mark"
    """A mark on a recording, its change or its deletion."""
    SESSION = "session"
    """A laboratory session was begun, changed or ended."""
    CHAIN = "chain"
    """The journal's note about itself: where its chain begins, or that a line was cut off."""


class Result(StrEnum):
    """How a request in the journal ended."""

    DONE = "done"
    REFUSED = "refused"
    FAILED = "failed"
    """The request was permitted, but could not be carried out."""


class JournalEntry(Record):
    """A line of the journal: what happened, who did it, and the full record that it is about, if there is one."""

    at: str = Field(description="ISO 8601, UTC")
    kind: JournalKind
    text: str
    by: str | None = None
    priority: Priority | None = None
    value: float | None = None
    limit: float | None = None
    unit: str | None = None
    run: Run | None = Field(default=None, description="The run at that time")
    alarm: Alarm | None = Field(default=None, description="The alarm at that time")
    file: FileRecord | None = Field(default=None, description="The recording that was deleted or restored")
    truth: GraspTruth | None = Field(default=None, description="The ground truth that was stated or corrected")
    mark: Mark | None = Field(default=None, description="The mark that was set, changed or deleted")
    lab_session: LabSession | None = Field(default=None, description="The laboratory session in this version")
    completed: CompletedFile | None = Field(default=None, description="The recording that was completed")
    action: str | None = Field(default=None, description="Requested action: the name of the route or of the command")
    client: str | None = Field(default=None, description="Address that the request came from")
    result: Result | None = None
    reason: str | None = Field(default=None, description="Why the request was refused or failed")
    chain: str | None = Field(default=None, description="Chain of the line; null, as all below: it is in none")
    number: int | None = Field(default=None, description="One more than the number of the line before")
    after: str | None = Field(default=None, description="Hash of the line before")
    begins: str | None = Field(default=None, description="The chain begins here: hash of everything before in the file")
    torn: str | None = Field(default=None, description="Hash of the cut-off line before this one, if there is one")
    hash: str | None = Field(default=None, description="SHA-256 of the line up to here, hexadecimal")

    def to_line(self, exclude: Mapping[str, set[str]] | None = None) -> str:
        """Return the entry as a journal line. Null fields are omitted, except within the record.

        `exclude` names fields of the record to leave out, by the name of its field.
        """
        empty = {name: True for name in type(self).model_fields if getattr(self, name) is None}
        return self.model_dump_json(exclude={**(exclude or {}), **empty})

    def without_chain(self) -> Self:
        """Return a copy without the fields of the chain."""
        return self.model_copy(update=dict.fromkeys(CHAIN_FIELDS))


RECORD_FIELDS = ("run", "alarm", "file", "truth", "mark", "lab_session")
"""Fields of an entry that hold the record that it is about, which the index keeps, too."""
CHAIN_FIELDS = ("chain", "number", "after", "begins", "torn", "hash")


class JournalCheck(Message):
    """The result of a check that the journal is as it was written."""

    whole: bool = Field(description="No line was changed, removed or inserted, as far as the check can tell")
    problem: str | None = Field(description="First place that is not as it was written, and the error there")
    notes: list[str] = Field(description="Remarks that are no problem, such as a cut-off line")
    lines: int = Field(description="Lines in the chain")
    unchained: int = Field(description="Lines of an older version before the chain, which no hash protects")
    newest: int | None = Field(description="Number of the newest line")
    newest_hash: str | None = Field(description="Hash of that line: a kept copy shows later whether it was changed")
    checked_at: str = Field(description="ISO 8601, UTC")
