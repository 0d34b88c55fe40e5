"""The committed schemas are those of the code, and a change that older clients or files do not bear is refused."""

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from app.messages import json_schema
from app.messages.live import FRAME_HEADER

COMMITTED = Path(json_schema.__file__).parents[2] / "frontend" / "src" / "wire.schema.json"
Change = Callable[[dict[str, Any]], None]


def test_the_dashboards_types_come_from_the_contract_as_it_is():
    """If this fails: `make wire`, then build and commit."""
    assert COMMITTED.read_text() == json_schema.render(json_schema.build_schema())


def test_the_committed_schema_of_the_records_is_that_of_the_code():
    """If this fails: `make wire`, then commit."""
    assert json_schema.RECORDS_FILE.read_text() == json_schema.render(json_schema.build_records_schema())


def test_the_frame_header_has_the_size_that_the_dashboard_decodes():
    assert json_schema.build_schema()["x-frame"]["header_bytes"] == FRAME_HEADER.size == 32


def refused(*, wire: Change = lambda schema: None, records: Change = lambda schema: None) -> list[str]:
    """What is refused if the version before was this one with these changes."""
    wire_before, records_before = json_schema.build_schema(), json_schema.build_records_schema()
    wire(wire_before)
    records(records_before)
    return json_schema.find_refused_changes(wire_before, records_before)


def set_field(name: str, field: str, content: dict[str, Any] | None) -> Change:
    """Give a definition this field, or take it away."""

    def change(schema: dict[str, Any]) -> None:
        about = schema["$defs"][name]
        about["properties"].pop(field, None)
        about["required"] = [each for each in about.get("required", []) if each != field]
        if content is not None:
            about["properties"][field] = content

    return change


def test_the_code_as_it_is_and_added_fields_are_accepted():
    assert refused() == []
    assert refused(wire=set_field("State", "viewers", None)) == []  # before, it was not sent
    assert refused(wire=set_field("RunRequest", "tissue", None)) == []  # optional
    assert refused(records=set_field("Alarm", "change", None)) == []  # has a default


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (set_field("State", "mood", {"type": "string"}), "State.mood is lost"),
        (set_field("State", "viewers", {"type": "string"}), "State.viewers has values that it did not have before"),
        (set_field("Run", "by", {"type": "string"}), "Run.by has values that it did not have before"),
        (set_field("RunRequest", "protocol", None), "RunRequest.protocol has no default"),
        (set_field("RunRequest", "speed", {"type": "number"}), "RunRequest.speed is lost"),
        (lambda schema: schema["$defs"]["Phase"]["enum"].remove("replay"), "Phase has values"),
        (lambda schema: schema["$defs"].update(Mood={"type": "object", "properties": {}}), "Mood is lost"),
        (lambda schema: schema["x-frame"].update(header_bytes=28), "the binary frame changed"),
    ],
)
def test_a_change_that_an_older_client_does_not_bear_needs_a_raised_version(change: Change, text: str):
    assert [each for each in refused(wire=change) if each.startswith(text)]

    def and_an_older_version(schema: dict[str, Any]) -> None:
        change(schema)
        schema["x-schema-version"] -= 1

    assert refused(wire=and_an_older_version) == []


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (set_field("Run", "ward", {"type": "string"}), "Run.ward is lost"),
        (set_field("Alarm", "text", None), "Alarm.text has no default"),
        (set_field("Grasp", "label", {"type": "integer"}), "Grasp.label does not accept what it did before"),
        (lambda schema: schema["$defs"]["RunState"]["enum"].append("paused"), "RunState does not accept"),
    ],
)
def test_a_change_that_older_files_do_not_bear_is_refused_in_every_version(change: Change, text: str):
    def older(schema: dict[str, Any]) -> None:
        schema["x-schema-version"] -= 1

    assert [each for each in refused(wire=older, records=change) if each.startswith(text)]


def test_the_command_writes_nothing_that_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    before = copy.deepcopy(json_schema.build_schema())
    set_field("State", "mood", {"type": "string"})(before)
    wire, records = tmp_path / "wire.json", tmp_path / "records.json"
    wire.write_text(json.dumps(before))
    records.write_text(json_schema.RECORDS_FILE.read_text())
    monkeypatch.setattr(json_schema, "SCHEMA_FILE", wire)
    monkeypatch.setattr(json_schema, "RECORDS_FILE", records)
    with pytest.raises(SystemExit, match=r"State\.mood is lost[\s\S]*raised SCHEMA_VERSION"):
        json_schema.main()
    assert json.loads(wire.read_text()) == before
