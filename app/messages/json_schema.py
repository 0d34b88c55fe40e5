"""The JSON schemas of what is sent and of what is stored, which are committed; a test compares them with the code.

`python -m app.messages.json_schema` writes both. `frontend/src/wire.schema.json` is what is sent; the dashboard's
TypeScript types are generated from it. `app/messages/records.schema.json` is what is stored. It refuses a change that
older clients or older files do not bear: see "Versions" in `docs/programs.md`.
"""

import json
import re
import struct
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode

from acquisition.signal_table import SIGNALS
from app.messages.alarms import AcknowledgeRequest, Alarm
from app.messages.annotations import (
    GraspTruth,
    Mark,
    MarkChange,
    MarkRequest,
    TruthCorrection,
    TruthRequest,
    TruthStatement,
)
from app.messages.base import SCHEMA_VERSION, Message, Record, Request
from app.messages.calibration import Calibration, CalibrationRequest
from app.messages.compatibility import find_unexpected_changes, find_unreadable_changes
from app.messages.grasps import Grasp, GraspEnded, Identification
from app.messages.journal import JournalCheck, JournalEntry
from app.messages.lab_sessions import LabSession, LabSessionChange, LabSessionRequest
from app.messages.live import FRAME_HEADER, FRAME_KINDS, FRAME_MAGIC, FrameReceived, ReplayControl, ServerMessage
from app.messages.named_files import (
    ApprovalRequest,
    FileCheck,
    FileContent,
    FileList,
    FileRequest,
    FileText,
    LibraryApproval,
    LibraryVersion,
    RestoreRequest,
    ToolDraftReport,
)
from app.messages.people import ControlInfo, ControlRequest, SessionInfo, SignIn
from app.messages.recordings import BinContent, FileRecord, Recordings, RunManifest
from app.messages.runs import DeclineRequest, Run, RunRequest, SpotRequest, StopAnswer, StopRequest
from app.messages.studies import Studies, StudyRequest, StudyRun
from app.messages.system import Health, Problem, System
from app.messages.tool import ArmRequest, LibraryInfo, ProtocolInfo, SafetyReport

RECORDS_FILE = Path(__file__).parent / "records.schema.json"
SCHEMA_FILE = Path(__file__).parents[2] / "frontend" / "src" / "wire.schema.json"

SENT_BY_SERVER: tuple[type[Message], ...] = (
    Run,
    ProtocolInfo,
    LibraryInfo,
    Grasp,
    StopAnswer,
    Health,
    Problem,
    Alarm,
    JournalEntry,
    JournalCheck,
    Recordings,
    BinContent,
    Studies,
    StudyRun,
    System,
    SafetyReport,
    SessionInfo,
    ControlInfo,
    Calibration,
    FileList,
    FileCheck,
    FileContent,
    ToolDraftReport,
    LibraryVersion,
    TruthStatement,
)
"""Answers to requests, beside the `ServerMessage`s of the live stream."""
SENT_BY_CLIENT: tuple[type[Request], ...] = (
    RunRequest,
    ArmRequest,
    StopRequest,
    SpotRequest,
    DeclineRequest,
    FrameReceived,
    AcknowledgeRequest,
    ReplayControl,
    StudyRequest,
    SignIn,
    ControlRequest,
    CalibrationRequest,
    FileText,
    FileRequest,
    ApprovalRequest,
    RestoreRequest,
    TruthRequest,
    TruthCorrection,
    MarkRequest,
    MarkChange,
    LabSessionRequest,
    LabSessionChange,
)
STORED: tuple[type[Record], ...] = (
    Run,
    GraspEnded,
    GraspTruth,
    Mark,
    LabSession,
    Alarm,
    Identification,
    JournalEntry,
    FileRecord,
    RunManifest,
    StudyRun,
    LibraryApproval,
)

# Fields of `FRAME_HEADER`, in order
HEADER_FIELDS = ("magic", "kind", "stride", "columns", "rows", "sequence", "first_tick", "newest_ms")


class _TypeScriptSchemaGenerator(GenerateJsonSchema):
    """A generator that omits field titles, which would become types, and requires each field that the server sends."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False

    def field_is_required(self, field: Any, total: bool) -> bool:
        return self.mode == "serialization" or super().field_is_required(field, total)


def _collect_definitions(inputs: list[tuple[str, JsonSchemaMode, TypeAdapter[Any]]]) -> dict[str, Any]:
    roots, rest = TypeAdapter.json_schemas(
        inputs, ref_template="#/$defs/{model}", schema_generator=_TypeScriptSchemaGenerator
    )
    definitions = dict(rest["$defs"])
    for (name, _), root in roots.items():
        definitions.setdefault(name, root)
    return dict(sorted(definitions.items()))


def build_schema() -> dict[str, Any]:
    """Return the schema of what is sent: messages and bodies under `$defs`, the frame's header under `x-frame`."""
    inputs: list[tuple[str, JsonSchemaMode, TypeAdapter[Any]]] = [
        ("ServerMessage", "serialization", TypeAdapter(ServerMessage)),
        *((each.__name__, "serialization", TypeAdapter(each)) for each in SENT_BY_SERVER),
        *((each.__name__, "validation", TypeAdapter(each)) for each in SENT_BY_CLIENT),
    ]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Wire",
        "description": "Written by `python -m app.messages.json_schema`; change `app/messages/` instead.",
        "$defs": _collect_definitions(inputs),
        "x-schema-version": SCHEMA_VERSION,
        "x-frame": describe_frame_layout(),
        "x-traces": describe_traces(),
    }


def build_records_schema() -> dict[str, Any]:
    """Return the schema of the records that are stored, by which `read_stored` reads them."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Records",
        "description": "Written by `python -m app.messages.json_schema`; change `app/messages/` instead.",
        "$defs": _collect_definitions([(each.__name__, "validation", TypeAdapter(each)) for each in STORED]),
    }


def describe_traces() -> list[dict[str, str]]:
    """Return the lines of the dashboard's charts that the table of signals asks for."""
    return [{"channel": signal.name, "unit": signal.unit, **asdict(signal.trace)} for signal in SIGNALS if signal.trace]


def describe_frame_layout() -> dict[str, Any]:
    """Return the frame header's magic, `struct` format, size, kinds, and the byte offset of each field."""
    order, *codes = _split_struct_codes(FRAME_HEADER.format)
    if len(codes) != len(HEADER_FIELDS):
        raise RuntimeError("FRAME_HEADER changed: bring HEADER_FIELDS in app/messages/json_schema.py up to date")
    offsets = [struct.calcsize(order + "".join(codes[:i])) for i in range(len(codes))]
    return {
        "magic": FRAME_MAGIC.decode("ascii"),
        "format": FRAME_HEADER.format,
        "header_bytes": FRAME_HEADER.size,
        "kinds": {str(kind): code for kind, code in FRAME_KINDS.items()},
        "offsets": dict(zip(HEADER_FIELDS, offsets, strict=True)),
    }


def _split_struct_codes(layout: str) -> list[str]:
    """Split `<4sBB` into `<`, `4s`, `B`, `B`."""
    codes, count = [layout[0]], ""
    for char in layout[1:]:
        count += char
        if not char.isdigit():
            codes.append(count)
            count = ""
    return codes


def render(schema: dict[str, Any]) -> str:
    """Return the exact content of a schema's file."""
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def find_refused_changes(wire_before: dict[str, Any], records_before: dict[str, Any]) -> list[str]:
    """Return the changes since the committed schemas that older clients or older files do not bear."""
    wire, records = build_schema(), build_records_schema()
    refused = find_unreadable_changes(records_before["$defs"], records["$defs"])
    if wire["x-schema-version"] <= wire_before["x-schema-version"]:
        before = wire_before["$defs"]
        requests = {each.__name__: before[each.__name__] for each in SENT_BY_CLIENT if each.__name__ in before}
        values = {name: before[name] for name in re.findall(r"#/\$defs/(\w+)", json.dumps(requests))}
        answers = {name: content for name, content in before.items() if name not in requests}
        refused += find_unreadable_changes(requests | values, wire["$defs"])
        refused += find_unexpected_changes(answers, wire["$defs"])
        if wire["x-frame"] != wire_before["x-frame"]:
            refused.append("the binary frame changed")
    return refused


def main() -> None:
    """Write both files, or say which change is refused and what to do."""
    wire_before, records_before = (json.loads(path.read_text()) for path in (SCHEMA_FILE, RECORDS_FILE))
    if refused := find_refused_changes(wire_before, records_before):
        raise SystemExit(
            "\n".join(refused)
            + "\nA change of what is sent needs a raised SCHEMA_VERSION (app/messages/base.py). A record "
            "is never changed so: add a field with a default, and keep the old one (docs/programs.md, Versions)."
        )
    for path, schema in ((SCHEMA_FILE, build_schema()), (RECORDS_FILE, build_records_schema())):
        path.write_text(render(schema), encoding="utf-8")
        print(f"wrote {path}")


if __name__ == "__main__":
    main()
