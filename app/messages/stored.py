"""The function that reads stored records back from index rows, recordings, journal lines and studies' folders.

A record is stored as its JSON; a writer may leave out fields that are null. `read_stored` reads what any version wrote:

- a field that this version does not know is ignored: a newer version wrote it, or an older one that had it;
- a field that is missing gets its default. A field without a default is null: its writer left it out.

So a field that is added to a record needs a default, which says what was the case before there was the field. A client
still gets every field, because defaults are sent. `app/messages/json_schema.py` refuses any other change of a record.
"""

import json
from typing import Any, TypeVar, get_args

from pydantic import BaseModel

from app.messages.base import Record

RecordT = TypeVar("RecordT", bound=Record)


def read_stored(kind: type[RecordT], content: bytes | str | dict[str, Any]) -> RecordT:
    """Return the record that was stored as JSON.

    Raises:
        ValueError: it is no record of this kind.
    """
    try:
        stored = json.loads(content) if isinstance(content, bytes | str) else content
    except RecursionError:
        raise ValueError("objects within objects without end") from None
    if not isinstance(stored, dict):
        raise ValueError("it is no object")
    return kind.model_validate(_restore_nulls(kind, stored))


def _restore_nulls(model: type[BaseModel], content: dict[str, Any]) -> dict[str, Any]:
    """Set required fields that are missing to null, also in nested records."""
    result: dict[str, Any] = {name: None for name, field in model.model_fields.items() if field.is_required()}
    for name, value in content.items():
        field = model.model_fields.get(name)
        inner = _find_nested_model(field.annotation) if field else None
        if inner and isinstance(value, list):
            result[name] = [_restore_nulls(inner, each) if isinstance(each, dict) else each for each in value]
        else:
            result[name] = _restore_nulls(inner, value) if inner and isinstance(value, dict) else value
    return result


def _find_nested_model(annotation: Any) -> type[BaseModel] | None:
    """Return the model in a field's type, such as `Model | None` or a list of models; None if it has none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for each in get_args(annotation) if (found := _find_nested_model(each))), None)
