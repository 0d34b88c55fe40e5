"""The service's part of `make reference`: commands, settings, requests, live stream, metrics."""

import re
import tomllib
from pathlib import Path
from typing import Any

import typer
from fastapi import FastAPI
from fastapi.routing import APIWebSocketRoute
from typer.cli import get_docs_for_click
from typer.main import get_command

from acquisition.signal_table import SIGNALS
from app.api.app import ROUTERS
from app.cli import main
from app.messages import live
from app.messages.asyncapi import FROM_REPLAY, FROM_REPLAY_VIEWER, find_used_schemas, render_asyncapi
from app.messages.json_schema import HEADER_FIELDS, build_schema, describe_frame_layout
from app.people.route_permissions import collect_route_permissions
from app.service.metrics import Metrics
from app.stream.frames import ESTIMATE_COLUMNS, SAMPLE_COLUMNS, SD_COLUMNS, TISSUE_COLUMNS
from config.load import CONFIG_DIR

DOCS = Path(__file__).parent
MESSAGES, ANSWERS = FROM_REPLAY, FROM_REPLAY_VIEWER
WRITTEN = "Written by `make reference` from the code; change that instead.\n"


def commands() -> str:
    """Every command with its options, by typer's own generator."""
    command = get_command(main.app)
    context = typer.Context(command, info_name="graspwatch")
    return get_docs_for_click(obj=command, ctx=context, name="graspwatch", title="Commands") + "\n"


def settings() -> str:
    """The shipped file with its comments: each line is the default."""
    text = (CONFIG_DIR / "graspwatch.toml").read_text(encoding="utf-8")
    tomllib.loads(text)
    return (
        f"# Settings\n\n{WRITTEN}\n`graspwatch serve --config FILE` takes settings from a file. What is not in it is "
        f"as below; unknown keys and impossible values are refused, all at once.\n\n```toml\n{text}```\n"
    )


def requests() -> str:
    """Every route: who may, what it does, what it takes and answers."""
    api = FastAPI()
    for router in ROUTERS:
        api.include_router(router)
    roles = collect_route_permissions(ROUTERS)
    parts = [
        f"# Requests\n\n{WRITTEN}\nThe service's own `/docs` tries them out, with every field. Errors are "
        "`application/problem+json` (RFC 9457): `detail` says what is wrong and what to do. Who may: with tokens, each "
        "role as much as those before it ([people](../people.md)).\n",
        "| request | who may | does | takes | answers |",
        "|---|---|---|---|---|",
    ]
    for path, methods in api.openapi()["paths"].items():
        for method, about in methods.items():
            role = roles.get((method.upper(), path))
            body = about.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema", {})
            words = " ".join(about.get("description", about["summary"]).split())
            parts.append(
                f"| `{method.upper()} {path}` | {role.value if role else 'everybody'} | {words} | {_name(body)} "
                f"| {_answer(about['responses'])} |"
            )
    for router in ROUTERS:
        for route in router.routes:
            if isinstance(route, APIWebSocketRoute):
                role, words = roles["WEBSOCKET", route.path], " ".join((route.endpoint.__doc__ or "").split())
                stream = "[live stream](stream.md)"
                parts.append(f"| `WebSocket {route.path}` | {role.value} | {words} | {stream} | {stream} |")
    return "\n".join(parts) + "\n"


def _answer(responses: dict[str, Any]) -> str:
    for status, about in responses.items():
        if status.startswith("2"):
            content = about.get("content", {})
            return _name(content.get("application/json", {}).get("schema", {})) or next(iter(content), "")
    return ""


def _name(prop: dict[str, Any]) -> str:
    """A type in a word."""
    if "$ref" in prop:
        return f"`{prop['$ref'].rpartition('/')[2]}`"
    if "const" in prop:
        return f"`{prop['const']}`"
    options = prop.get("anyOf") or prop.get("oneOf")
    if options:
        return " or ".join(_name(each) for each in options)
    if prop.get("type") == "array":
        return f"list of {_name(prop.get('items', {}))}"
    if prop.get("type") == "object" and isinstance(prop.get("additionalProperties"), dict):
        return f"{_name(prop['additionalProperties'])} by name"
    return prop.get("title", "") if prop.get("type") == "object" else prop.get("type", "")


def stream() -> str:
    """Messages and frames of `/api/live`."""
    contract = build_schema()["$defs"]
    parts = [f"# Live stream\n\n{WRITTEN}\n{_paragraphs(live.__doc__)}\n", "## What the server sends\n"]
    parts += [_table(name, contract) for name in MESSAGES]
    parts.append("## What a viewer sends\n")
    parts += [_table(name, contract) for name in ANSWERS]
    inside = sorted(find_used_schemas(MESSAGES, contract) - set(MESSAGES))
    parts.append("## What stands in them\n")
    parts += [_table(name, contract) for name in inside]
    frame = describe_frame_layout()
    kinds = ", ".join(f"{code} `{kind}`" for kind, code in frame["kinds"].items())
    parts.append(
        f"## The binary frame\n\n`{frame['format']}` of Python's `struct`, {frame['header_bytes']} bytes, magic "
        f"`{frame['magic']}`, kinds {kinds}; then the columns.\n"
    )
    parts += ["| field | byte |", "|---|---|", *(f"| `{name}` | {frame['offsets'][name]} |" for name in HEADER_FIELDS)]
    parts.append("\n## The channels\n\nThe columns of a frame, as `Hello.channels` lists them. NaN: no value.\n")
    parts += ["| channel | unit | what it is |", "|---|---|---|"]
    for about, columns in (("", SAMPLE_COLUMNS | ESTIMATE_COLUMNS), (", for each tissue", TISSUE_COLUMNS | SD_COLUMNS)):
        parts += [f"| `{name}` | {unit} | {meaning}{about} |" for name, (unit, meaning) in columns.items()]
    parts.append(
        "\n## The signals of a recording\n\nThe rows `/raw` and `/conditioned` of a recording "
        "([recordings](../recordings.md)) and the columns of an export, from `acquisition/signal_table.py`. NaN: no "
        "value.\n"
    )
    parts += ["| signal | unit | type | source | row, field | what it is |", "|---|---|---|---|---|---|"]
    for each in SIGNALS:
        rows = [f"{row} {number}" for row, number in (("raw", each.raw), ("conditioned", each.conditioned)) if number]
        parts.append(
            f"| `{each.name}` | {each.unit} | `{each.dtype}` | {each.source} | {', '.join(rows)} | {each.meaning} |"
        )
    return "\n".join(parts) + "\n"


def _paragraphs(text: str | None) -> str:
    return re.sub(r"(?<!\n)\n(?!\n)", " ", (text or "").strip())


def _table(name: str, contract: dict[str, Any]) -> str:
    about = contract[name]
    words = " ".join(about.get("description", "").split())
    if "enum" in about:
        return f"### {name}\n\n{words} One of {', '.join(f'`{each}`' for each in about['enum'])}.\n"
    rows = [f"### {name}\n", f"{words}\n", "| field | type | what it is |", "|---|---|---|"]
    for field, prop in about.get("properties", {}).items():
        rows.append(f"| `{field}` | {_name(prop)} | {' '.join(prop.get('description', '').split())} |")
    return "\n".join(rows) + "\n"


def metrics() -> str:
    """What Prometheus reads."""
    parts = [
        f"# Metrics\n\n{WRITTEN}\n`GET /metrics`, with a viewer's token where there are tokens; see "
        "[operating](../operating.md). Beside them stand the usual `process_*` and `python_info` of the server.\n",
        "| metric | kind | what it is |",
        "|---|---|---|",
    ]
    told = Metrics(workers=(), labels=()).render().decode()
    for name, what, kind in re.findall(r"# HELP (graspwatch_\S+) (.*)\n# TYPE \S+ (\w+)", told):
        if not name.endswith("_created"):
            parts.append(f"| `{name}` | {kind} | {what} |")
    return "\n".join(parts) + "\n"


def decisions() -> str:
    """The records by number."""
    lines = ["# Decisions\n", "Design choices that a newcomer may question, with their reasons.\n"]
    for path in sorted((DOCS / "decisions").glob("0*.md")):
        title = path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
        lines.append(f"- [{title}]({path.name})")
    return "\n".join(lines) + "\n"


def client() -> str:
    """For mkdocstrings, which reads the docstrings itself."""
    names = ("Graspwatch", "Frame", "ClientError", "UnreachableError", "RefusedError", "ConnectionLostError")
    about = "`pip install graspwatch` brings it; [programs](../programs.md) shows how to use it.\n"
    parts = ["# Python client\n", about]
    return "\n".join(parts + [f"::: graspwatch.{name}\n" for name in names])


def written() -> dict[str, str]:
    """Each file's content by its place in docs/."""
    return {
        "reference/commands.md": commands(),
        "reference/settings.md": settings(),
        "reference/requests.md": requests(),
        "reference/stream.md": stream(),
        "reference/asyncapi.json": render_asyncapi(),
        "reference/metrics.md": metrics(),
        "reference/client.md": client(),
        "decisions/index.md": decisions(),
    }
