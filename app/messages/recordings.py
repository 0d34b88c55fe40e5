"""Messages about recordings and the bin."""

from enum import StrEnum

from pydantic import Field

from app.messages.base import Message, Record


class FileCondition(StrEnum):
    """The completeness of a recording."""

    COMPLETE = "complete"
    RECOVERED = "recovered"
    """The recording was cut off, and has been repaired."""
    CUT_OFF = "cut off"


class FileRecord(Record):
    """A recording as the index knows it. A value that is missing or unreadable is null."""

    name: str
    run_id: str | None
    size_bytes: int
    made_at: str = Field(description="ISO 8601, UTC")
    duration_s: float | None
    samples: int | None
    lost_samples: int | None
    format_version: str | None
    condition: FileCondition | None
    problem: str | None
    deleted_at: str | None = Field(default=None, description="ISO 8601, UTC; null: not deleted")
    deleted_by: str | None = None


class RunManifest(Record):
    """How a run was recorded: software, machine, and the SHA-256 of all that went in."""

    metadata: dict[str, str] = Field(description="The metadata `graspwatch` of the file: run, tool, library, operator")
    commit: str | None = Field(
        description="Commit of the program's source; it ends with `-dirty` if files differed from it; null: not known"
    )
    versions: dict[str, str] = Field(description="Versions of Graspwatch, Python and the computing packages")
    system: str = Field(description="Operating system")
    realtime: dict[str, str] = Field(
        description="Scheduling that the system granted acquisition and estimator, as far as the recorder knew it"
    )
    sha256: dict[str, str] = Field(description="SHA-256 of each attachment, hexadecimal")


class CompletedFile(Record):
    """A recording's file as it was when it was completed."""

    name: str
    sha256: str = Field(description="SHA-256 of the whole file, hexadecimal")


class RecordingInfo(Message):
    """A file of the recordings folder."""

    name: str
    size_bytes: int
    modified_at: str = Field(description="ISO 8601, UTC")
    recorded_at: str = Field(
        description="ISO 8601: when an imported recording was made, by its log's own clock; else `modified_at`"
    )
    duration_s: float | None = Field(description="Null: not read yet, or unreadable")
    problem: str | None = Field(description="Why the recording cannot be replayed")
    whole: bool = Field(description="False while it is being written or has not been read, or if it was cut off")
    run_id: str | None = Field(description="Null: the file is no recording of a run")
    protocol: str | None
    tissue: str | None = Field(description="Tissue given in the request for the run")
    by: str | None
    subject: str | None = Field(default=None, description="Subject of its laboratory session")
    labels: list[str] = Field(default=[], description="Answers of its grasps, in order, as far as the index knows them")
    held: list[str] = Field(default=[], description="What people say was held, each tissue or remark once")


class Recordings(Message):
    """The list of the recordings folder."""

    folder: str
    recordings: list[RecordingInfo]


class BinnedRecording(Message):
    """A deleted recording that can be restored."""

    entry: str = Field(description="Name of the entry in the bin")
    name: str
    size_bytes: int
    deleted_at: str = Field(description="ISO 8601, UTC")
    deleted_by: str | None
    expires_at: str = Field(description="ISO 8601, UTC; soon after that the recording is permanently deleted")


class BinContent(Message):
    """The content of the bin, last deleted first. It takes disk space until the bin is emptied."""

    recordings: list[BinnedRecording]
    size_bytes: int
    keep_days: float


class Emptied(Message):
    """The result of emptying the bin, which deletes permanently."""

    removed: int
    freed_bytes: int


class ReportProgress(Message):
    """The progress of a report that is being made."""

    done: float = Field(description="Finished share of the work, 0 to 1")
