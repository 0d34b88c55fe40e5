"""JSON topics of a recording: records of `app/messages/`, with schemas that plotting programs understand.

Those programs read JSON schemas without references and with one type a field. So a field without a value is left out of
a message instead of being null.
"""

import json
from typing import Any

from pydantic import BaseModel, ConfigDict

from app.messages.alarms import Alarm
from app.messages.annotations import Mark
from app.messages.base import Record
from app.messages.grasps import GraspEnded, Identification
from app.messages.journal import JournalEntry
from app.messages.runs import Run
from app.messages.stored import read_stored

RUN_TOPIC, GRASP_TOPIC, ALARM_TOPIC, IDENTIFICATION_TOPIC, JOURNAL_TOPIC, MARK_TOPIC = (
    "/run",
    "/grasp",
    "/alarm",
    "/identification",
    "/journal",
    "/mark",
)


class FoxgloveTime(Record):
    """A time since 1970 (foxglove.Time)."""

    sec: int
    nsec: int


class FoxgloveKeyValue(Record):
    """A fact about an event (foxglove.KeyValuePair)."""

    key: str
    value: str


class FoxgloveEvent(Record):
    """A mark as plotting programs understand it (foxglove.Event). The mark itself is in its journal line."""

    model_config = ConfigDict(title="foxglove.Event")

    start_time: FoxgloveTime
    end_time: FoxgloveTime
    metadata: list[FoxgloveKeyValue]


TOPIC_MODELS: dict[str, type[Record]] = {
    RUN_TOPIC: Run,
    GRASP_TOPIC: GraspEnded,
    ALARM_TOPIC: Alarm,
    IDENTIFICATION_TOPIC: Identification,
    JOURNAL_TOPIC: JournalEntry,
    MARK_TOPIC: FoxgloveEvent,
}
SCHEMA_NAMES = {topic: model.model_config.get("title") or model.__name__ for topic, model in TOPIC_MODELS.items()}
_MODEL_TOPICS: dict[type[BaseModel], str] = {model: topic for topic, model in TOPIC_MODELS.items()}


def find_topic(message: BaseModel) -> str | None:
    """Return the topic that a message is recorded under; None if it is not recorded."""
    return _MODEL_TOPICS.get(type(message))


def build_foxglove_event(mark: Mark) -> FoxgloveEvent:
    """Return a mark as an event at the time of its sample."""
    sec, rest_ms = divmod(mark.at_ms, 1e3)
    at = FoxgloveTime(sec=int(sec), nsec=int(rest_ms * 1e6))
    facts = {"text": mark.text, "by": mark.by, "run": mark.run_id, "id": mark.id}
    metadata = [FoxgloveKeyValue(key=key, value=value) for key, value in facts.items() if value]
    return FoxgloveEvent(start_time=at, end_time=at, metadata=metadata)


def encode_message(message: BaseModel) -> bytes:
    return message.model_dump_json(exclude_none=True).encode()


def decode_message(topic: str, content: bytes) -> Record:
    """Return the record that `encode_message` encoded, in this version or another one.

    Raises:
        ValueError: it is not a record of this topic.
    """
    return read_stored(TOPIC_MODELS[topic], content)


def build_json_schema(model: type[BaseModel]) -> bytes:
    """Return the JSON schema of a model's messages, without references and nulls."""
    schema = model.model_json_schema(mode="serialization")
    return json.dumps(_simplify_schema(schema, schema.get("$defs", {}))).encode()


def _simplify_schema(schema: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    if "$ref" in schema:
        return _simplify_schema(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    if "anyOf" in schema:
        (some,) = [each for each in schema["anyOf"] if each.get("type") != "null"]
        return _simplify_schema(some, definitions) | (
            {"description": schema["description"]} if "description" in schema else {}
        )
    if "const" in schema or "enum" in schema:
        return {"type": "string"}
    plain: dict[str, Any] = {key: schema[key] for key in ("type", "title", "description") if key in schema}
    if "properties" in schema:
        plain["properties"] = {name: _simplify_schema(each, definitions) for name, each in schema["properties"].items()}
    if "items" in schema:
        plain["items"] = _simplify_schema(schema["items"], definitions)
    return plain
