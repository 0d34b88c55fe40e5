"""Functions that compare two JSON schemas and find the changes that break programs or files of the version before.

A changed type is compared by its alternatives: each of `anyOf`, each value of an enumeration, each plain type.
"""

from collections.abc import Callable
from typing import Any

Definitions = dict[str, dict[str, Any]]
REMARKS = ("title", "description", "default", "examples", "discriminator")


def find_unreadable_changes(before: Definitions, after: Definitions) -> list[str]:
    """Return the changes by which this version cannot read what the version before wrote.

    Those are a definition or field that is lost or narrowed, and a further required field.
    """
    changes = _compare(before, after, lambda old, new: _accepts(new, old), "does not accept what it did before")
    for name, old in before.items():
        for field in set(after.get(name, {}).get("required", [])) - set(old.get("required", [])):
            changes.append(f"{name}.{field} has no default")
    return sorted(changes)


def find_unexpected_changes(before: Definitions, after: Definitions) -> list[str]:
    """Return the changes by which the version before cannot read what this version writes.

    Those are a definition or field that is lost, and one that has further values.
    """
    return sorted(_compare(before, after, _accepts, "has values that it did not have before"))


def _compare(
    before: Definitions, after: Definitions, fits: Callable[[dict[str, Any], dict[str, Any]], bool], problem: str
) -> list[str]:
    changes = []
    for name, old in before.items():
        if name not in after:
            changes.append(f"{name} is lost")
            continue
        new = after[name]
        if "properties" not in old and not fits(old, new):
            changes.append(f"{name} {problem}")
        for field, content in old.get("properties", {}).items():
            if field not in new.get("properties", {}):
                changes.append(f"{name}.{field} is lost")
            elif not fits(content, new["properties"][field]):
                changes.append(f"{name}.{field} {problem}")
    return changes


def _accepts(wide: dict[str, Any], narrow: dict[str, Any]) -> bool:
    """Return whether each alternative of `narrow` is one of `wide`."""
    alternatives = _list_alternatives(wide)
    return all(each in alternatives for each in _list_alternatives(narrow))


def _list_alternatives(schema: dict[str, Any]) -> list[dict[str, Any]]:
    plain = {key: value for key, value in schema.items() if key not in REMARKS}
    options = plain.get("anyOf") or plain.get("oneOf")
    if options:
        return [each for option in options for each in _list_alternatives(option)]
    if "enum" in plain:
        return [{"const": value} for value in plain["enum"]]
    return [{"const": plain["const"]}] if "const" in plain else [plain]
