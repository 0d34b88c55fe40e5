"""`make reference`: what stands in a tool file, field by field, and its schema, from the classes that read it."""

import ast
import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import config.schema
import config.table_layout
from config.schema import Tool

FOLDER = Path(__file__).parent / "reference"
BOUNDS = {"exclusiveMinimum": "over", "minimum": "at least", "exclusiveMaximum": "under", "maximum": "at most"}
HEAD = """# The tool file, field by field

Written by `make reference` from the classes that read the file; `tool.schema.json` beside it is the same for programs
and editors (`#:schema tool.schema.json` as a file's first line). Units stand in the names. Unknown keys and impossible
values are refused, all at once, each with its place: `graspwatch check --tool FILE` shows them. What `graspwatch
calibrate` measures is named in the description. The shipped files are in `config/tools`.
"""


def written() -> dict[str, str]:
    """Each file's content by its name."""
    schema = Tool.model_json_schema()
    _describe(schema)
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    tables = [HEAD, *_table("the file itself", schema, schema)]
    for name, prop in schema["properties"].items():
        table = _resolved(prop, schema)
        if table and table["type"] == "object" and "properties" in table:
            tables += _table(f"`[{name}]`", table, schema)
    for kind, reference in schema["properties"]["kinematics"]["discriminator"]["mapping"].items():
        kinematics = schema["$defs"][reference.rpartition("/")[2]]
        tables += _table(f'`[kinematics]` with `kind = "{kind}"`', kinematics, schema)
    tables += _table("`[[channels.other]]`", schema["$defs"]["OtherInput"], schema)
    tables += _table("`[table.time]`", schema["$defs"]["TimeColumn"], schema)
    tables += _table("`[[table.columns]]`", schema["$defs"]["TableColumn"], schema)
    tables += _table("`[calibration.jaw_force_scale]`", schema["$defs"]["ForceScale"], schema)
    tables += _table("`[[calibration.measured]]`", schema["$defs"]["ConstantMeasurement"], schema)
    return {
        "tool-file.md": "\n".join(tables) + "\n",
        "tool.schema.json": json.dumps(schema, indent=2, ensure_ascii=False) + "\n",
    }


def _describe(schema: dict[str, Any]) -> None:
    """Put the text below each field of the classes into the schema."""
    tables = {schema["title"]: schema, **schema["$defs"]}
    files = (config.schema.__file__, config.table_layout.__file__)
    texts: dict[str, dict[str, str]] = {}  # by class and field, those of the classes that it is built on included
    for part in (part for file in files for part in ast.parse(Path(file).read_text(encoding="utf-8")).body):
        if not isinstance(part, ast.ClassDef):
            continue
        own = texts[part.name] = {}
        for base in part.bases:
            own |= texts.get(ast.unparse(base), {})
        for field, below in pairwise(part.body):
            match field, below:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    own[name] = " ".join(text.split())
    for title, table in tables.items():
        for name, about in table.get("properties", {}).items():
            if name in texts.get(title, {}):
                about["description"] = texts[title][name]


def _table(title: str, table: dict[str, Any], schema: dict[str, Any]) -> list[str]:
    about = " ".join(table.get("description", "").split())
    lines = ["", f"## {title[0].upper()}{title[1:]}", "", about, ""]
    lines += ["| key | value | default | what it is |", "|---|---|---|---|"]
    required = table.get("required", [])
    for name, prop in table["properties"].items():
        nested = _resolved(prop, schema)
        is_table = nested is not None and "properties" in nested
        is_own = is_table and table is schema
        value = f"table `[{name}]`" if is_own else "table, see below" if is_table else _value(prop, schema)
        if name in required:
            default = "required"
        elif is_table or isinstance(prop.get("default"), dict):
            default = "as below"
        else:
            default = "none" if prop.get("default") is None else f"`{json.dumps(prop['default'])}`"
        what = " ".join((prop.get("description") or (nested or {}).get("description") or "").split())
        lines.append(f"| `{name}` | {value} | {default} | {what} |")
    return lines


def _resolved(prop: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any] | None:
    """The definition that a property refers to, if it does."""
    for each in (prop, *prop.get("anyOf", ())):
        if "$ref" in each:
            return schema["$defs"][each["$ref"].rpartition("/")[2]]
    return None


def _value(prop: dict[str, Any], schema: dict[str, Any]) -> str:
    options = [each for each in prop.get("anyOf") or prop.get("oneOf", [prop]) if each.get("type") != "null"]
    return " or ".join(dict.fromkeys(_one(each, schema) for each in options))


def _one(prop: dict[str, Any], schema: dict[str, Any]) -> str:
    if "$ref" in prop:
        prop = schema["$defs"][prop["$ref"].rpartition("/")[2]]
    if "enum" in prop:
        return ", ".join(f"`{each}`" for each in prop["enum"])
    if prop["type"] == "array":
        items = prop.get("items") or prop["prefixItems"][0]
        many = f" of {len(prop['prefixItems'])}" if "prefixItems" in prop else ""
        return f"list{many}: {_one(items, schema)}"
    if prop["type"] == "object":
        return "table, see below" if "properties" in prop else "tables, see below"
    words = {"string": "day" if prop.get("format") == "date" else "text", "number": "number", "integer": "whole number"}
    bounds = [f"{word} {prop[key]:g}" for key, word in BOUNDS.items() if key in prop]
    if "pattern" in prop:
        bounds.append("`" + re.sub(r"\|", r"\\|", prop["pattern"]) + "`")
    return ", ".join([words.get(prop["type"], prop["type"]), *bounds])


if __name__ == "__main__":
    from reference_service import written as service

    for file, content in written().items():
        (FOLDER / file).write_text(content, encoding="utf-8")
    for file, content in service().items():
        (FOLDER.parent / file).write_text(content, encoding="utf-8")
