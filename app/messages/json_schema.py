"""The JSON schema of the messages, from which the dashboard's TypeScript types are generated.

`python -m app.messages.json_schema` writes it to `frontend/src/wire.schema.json`, which is committed. A test compares
the two.
"""

import json
import struct
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode

from app.messages.alarms import AcknowledgeRequest, Alarm
from app.messages.base import SCHEMA_VERSION, Message, Request
from app.messages.calibration import Calibration, CalibrationRequest
from app.messages.grasps import Grasp
from app.messages.journal import JournalCheck, JournalEntry
from app.messages.live import FRAME_HEADER, FRAME_KINDS, FRAME_MAGIC, FrameReceived, ReplayControl, ServerMessage
from app.messages.people import ControlInfo, ControlRequest, SessionInfo, SignIn
from app.messages.recordings import BinContent, Recordings
from app.messages.runs import Run, RunRequest, StopAnswer, StopRequest
from app.messages.studies import Studies, StudyRequest, StudyRun
from app.messages.system import Health, Problem, System
from app.messages.tool import ArmRequest, LibraryInfo, ProtocolInfo, SafetyReport

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
)
"""Answers to requests, beside the `ServerMessage`s of the live stream."""
SENT_BY_CLIENT: tuple[type[Request], ...] = (
    RunRequest,
    ArmRequest,
    StopRequest,
    FrameReceived,
    AcknowledgeRequest,
    ReplayControl,
    StudyRequest,
    SignIn,
    ControlRequest,
    CalibrationRequest,
)

# Fields of `FRAME_HEADER`, in order
HEADER_FIELDS = ("magic", "kind", "stride", "columns", "rows", "sequence", "first_tick", "newest_ms")


class _TypeScriptSchemaGenerator(GenerateJsonSchema):
    """A generator that omits field titles, which would become types, and requires each field that the server sends."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False

    def field_is_required(self, field: Any, total: bool) -> bool:
        return self.mode == "serialization" or super().field_is_required(field, total)


def build_schema() -> dict[str, Any]:
    """Build the schema: messages and bodies under `$defs`, the binary frame's header under `x-frame`."""
    inputs: list[tuple[str, JsonSchemaMode, TypeAdapter[Any]]] = [
        ("ServerMessage", "serialization", TypeAdapter(ServerMessage)),
        *((each.__name__, "serialization", TypeAdapter(each)) for each in SENT_BY_SERVER),
        *((each.__name__, "validation", TypeAdapter(each)) for each in SENT_BY_CLIENT),
    ]
    roots, rest = TypeAdapter.json_schemas(
        inputs, ref_template="#/$defs/{model}", schema_generator=_TypeScriptSchemaGenerator
    )
    definitions = dict(rest["$defs"])
    for (name, _), root in roots.items():
        definitions.setdefault(name, root)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Wire",
        "description": "Written by `python -m app.messages.json_schema`; change `app/messages/` instead.",
        "$defs": dict(sorted(definitions.items())),
        "x-schema-version": SCHEMA_VERSION,
        "x-frame": describe_frame_layout(),
    }


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


def render_schema() -> str:
    """Return the exact content of the schema file."""
    return json.dumps(build_schema(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    SCHEMA_FILE.write_text(render_schema(), encoding="utf-8")
    print(f"wrote {SCHEMA_FILE}")
