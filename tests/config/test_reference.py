"""The reference: as the code is now. Of the tool file: every field explained, and true of the shipped files."""

import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from scripts import load

from config.load import CONFIG_DIR

DOCS = Path(__file__).parents[2] / "docs"


def generated() -> dict[str, str]:
    return load(DOCS / "reference.py").written()


@pytest.mark.parametrize("name", ["tool-file.md", "tool.schema.json"])
def test_it_is_as_the_classes_are(name: str) -> None:
    assert (DOCS / "reference" / name).read_text(encoding="utf-8") == generated()[name], "run: make reference"


def test_the_service_is_as_its_reference_says() -> None:
    renewed = load(DOCS / "reference_service.py").written()
    assert {name: (DOCS / name).read_text(encoding="utf-8") for name in renewed} == renewed, "run: make reference"


def test_every_field_is_explained() -> None:
    schema = json.loads(generated()["tool.schema.json"])
    tables = {"Tool": schema, **schema["$defs"]}
    unexplained = [
        f"{table}.{name}"
        for table, about in tables.items()
        for name, prop in about.get("properties", {}).items()
        if not (prop.get("description") or "$ref" in json.dumps(prop))
    ]
    assert unexplained == []


@pytest.mark.parametrize("path", sorted((CONFIG_DIR / "tools").glob("*.toml")), ids=lambda path: path.stem)
def test_the_shipped_files_fit_the_schema(path: Path) -> None:
    def plain(value: Any) -> Any:
        return json.loads(json.dumps(value, default=str))

    jsonschema.validate(plain(tomllib.loads(path.read_text())), json.loads(generated()["tool.schema.json"]))
