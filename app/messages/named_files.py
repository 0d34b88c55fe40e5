"""Messages about the files that are chosen by name: protocols, tissue libraries and tool files."""

from typing import Annotated

from pydantic import Field

from app.messages.base import Message, PersonName, Record, Request
from app.messages.tool import LibraryInfo, ProtocolInfo
from config.load import FileKind

TOOL_NAME_PATTERN = r"^[a-z0-9][a-z0-9_]*$"
MAX_TEXT_CHARACTERS = 50_000  # as `most_body_bytes` of the settings allows


class LibraryApproval(Record):
    """Decision on one text of a tissue library: whether the service may use it on a real tool."""

    sha256: str = Field(description="SHA-256 of the text")
    library: str = Field(description="Name of the library")
    approved: bool = Field(description="False: an earlier approval is withdrawn")
    reason: str
    by: str | None
    at: str = Field(description="Time, ISO 8601")


class NamedFile(Message):
    """A shipped file, or an own one of the data folder."""

    kind: FileKind
    name: str = Field(description="Name by which it is chosen: the file's name without its ending")
    title: str | None = Field(description="Null: the file cannot be read")
    shipped: bool = Field(description="Whether it comes with the program, and cannot be changed")
    problems: list[str] = Field(description="Why it cannot be chosen, one message a fault")
    in_use: str | None = Field(description="Why it cannot be changed now; null: it can")
    approval: LibraryApproval | None = Field(
        default=None, description="Newest decision on the text of an own library; null: none. Shipped ones need none"
    )


class FileList(Message):
    """All files that are chosen by name, and the folder that holds the own ones."""

    folder: str
    files: list[NamedFile]


class FileCheck(Message):
    """Result of checking the text of a protocol, library or tool file: its faults, or a preview if there are none."""

    problems: list[str] = Field(description="One message a fault; none: the text is valid")
    name: str | None = Field(description="Name in the text; null: not valid")
    protocol: ProtocolInfo | None = Field(description="Preview of a valid protocol on the tool in use")
    library: LibraryInfo | None = Field(description="Tissues of a valid library")


class FileContent(FileCheck):
    """A file with its text."""

    file: NamedFile
    text: str
    version: str = Field(description="Identifies this text; a request that replaces it names it")


class LibraryVersion(Message):
    """One text of an own library: the present one, or one that was replaced."""

    version: str
    saved_at: str = Field(description="Time, ISO 8601, at which the text was saved")
    current: bool
    approval: LibraryApproval | None


class ApprovalRequest(Request):
    """Request to approve a library for real tools, or to withdraw that."""

    version: Annotated[str, Field(max_length=64, description="Of the text that was judged")]
    reason: Annotated[str, Field(min_length=3, max_length=300, description="Goes into the journal")]
    approved: bool = True
    by: PersonName | None = None


class RestoreRequest(Request):
    """Request to save an earlier text of a library again."""

    version: Annotated[str, Field(max_length=64, description="Of the earlier text")]
    replaces: str | None = Field(
        default=None, max_length=64, description="Version of the present text; null: the library was deleted"
    )
    by: PersonName | None = None


class ColumnSummary(Message):
    """A column of a recording that holds numbers."""

    number: int = Field(description="In the file, from 1")
    name: str = Field(description="Its heading; may be empty")
    low: float
    high: float
    means: list[float] = Field(description="Means of equal parts of the recording, for a small plot")


class TimeColumnGuess(Message):
    """The column that holds the times."""

    column: int
    unit: str
    rate_hz: float = Field(description="Samples a second by it")


class GraspSummary(Message):
    """A grasp that a tool file finds in a recording."""

    number: int
    start_s: float
    duration_s: float
    peak_force_n: float
    travel_m: float
    has_contact: bool


class ToolDraftReport(Message):
    """The columns of a recording and, once it is known what they are, a tool file for it and its first grasps."""

    columns: list[ColumnSummary]
    times: TimeColumnGuess | None = Field(description="Null: no column looks like times")
    text: str | None = Field(description="The tool file; null: force and position are not named yet")
    assumed: list[str] = Field(description="What the text assumes, because it was not said")
    grasps: int = Field(description="Number of grasps that the tool file finds")
    first_grasps: list[GraspSummary]


class DraftQuery(Request):
    """Request for a tool file from a recording: what its columns are, counted from 1."""

    file: Annotated[
        str, Field(pattern=r"^[^\x00-\x1f/]+$", max_length=200, description="Name of the recording, with its ending")
    ]
    name: Annotated[str, Field(pattern=TOOL_NAME_PATTERN, max_length=64)] = Field(
        default="my_tool", description="Name of the new tool"
    )
    force: int | None = Field(default=None, ge=1, description="Column of the force sensor")
    position: int | None = Field(default=None, ge=1, description="Column of the position sensor: angle or opening")
    command: int | None = Field(default=None, ge=0, description="Column of the motor command, V; 0: driven by hand")
    newton: float | None = Field(default=None, ge=0, description="Newtons at the jaws for one unit of the force")
    millimetre: float | None = Field(default=None, ge=0, description="Jaw travel for one unit of the position, mm")
    rate_hz: float | None = Field(default=None, ge=1, description="Samples a second, of a file without times")
    port: str | None = Field(default=None, max_length=200, description="Serial port that prints such lines")


class FileText(Request):
    """Request to check the text of a file."""

    text: Annotated[str, Field(max_length=MAX_TEXT_CHARACTERS)]


class FileRequest(FileText):
    """Request to save a text as a file, under the name in it."""

    replaces: str | None = Field(
        default=None, max_length=64, description="Version of the own file that it replaces; null: a new file"
    )
    by: PersonName | None = None
