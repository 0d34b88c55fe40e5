"""The live stream and the replays as AsyncAPI 3, which `make reference` writes to `docs/reference/asyncapi.json`."""

import json
import re
from typing import Any

from app import __version__
from app.messages.json_schema import build_schema

FROM_SERVICE = (
    "Hello",
    "State",
    "Identification",
    "GraspEnded",
    "GraspTruth",
    "Mark",
    "LabSession",
    "Alarm",
    "EventMessage",
)
FROM_REPLAY = (*FROM_SERVICE, "ReplayState")
FROM_VIEWER = ("FrameReceived",)
FROM_REPLAY_VIEWER = (*FROM_VIEWER, "ReplayControl")
FRAME = "SampleFrame"
AFTER = "Number of the last event that the viewer has received; the stream goes on with the events after it."


def render_asyncapi() -> str:
    """Return the exact content of `docs/reference/asyncapi.json`."""
    contract = build_schema()
    names = (*FROM_REPLAY, *FROM_REPLAY_VIEWER)
    schemas = {name: contract["$defs"][name] for name in sorted(find_used_schemas(names, contract["$defs"]))}
    document = {
        "asyncapi": "3.0.0",
        "info": {
            "title": "Graspwatch live stream",
            "version": __version__,
            "description": "Written by `make reference` from the code. The page `stream.md` beside it says the same.",
            "license": {"name": "Apache-2.0"},
        },
        "defaultContentType": "application/json",
        "servers": {
            "service": {
                "host": "localhost:8000",
                "protocol": "ws",
                "description": "A service with a certificate takes `wss`. Without tokens it needs no security scheme.",
                "security": [{"$ref": "#/components/securitySchemes/token"}],
            }
        },
        "channels": {
            "live": {
                "address": "/api/live",
                "description": "What the tool does now.",
                "messages": _references((*FROM_SERVICE, FRAME, *FROM_VIEWER)),
                "bindings": {
                    "ws": {
                        "query": {"type": "object", "properties": {"after": {"type": "integer", "description": AFTER}}}
                    }
                },
            },
            "replay": {
                "address": "/api/recordings/{name}/replay",
                "description": "A recording as if it were live, with pause, seek and speed.",
                "parameters": {"name": {"description": "Name of the recording"}},
                "messages": _references((*FROM_REPLAY, FRAME, *FROM_REPLAY_VIEWER)),
            },
        },
        "operations": {
            "sendLive": _operation("send", "live", (*FROM_SERVICE, FRAME)),
            "receiveFromViewer": _operation("receive", "live", FROM_VIEWER),
            "sendReplay": _operation("send", "replay", (*FROM_REPLAY, FRAME)),
            "receiveFromReplayViewer": _operation("receive", "replay", FROM_REPLAY_VIEWER),
        },
        "components": {
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
            "messages": {name: _message(name, schemas[name]) for name in names} | {FRAME: _frame(contract["x-frame"])},
            "schemas": schemas,
        },
    }
    text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
    return text.replace('"#/$defs/', '"#/components/schemas/')


def find_used_schemas(names: tuple[str, ...], schemas: dict[str, Any]) -> set[str]:
    """Return `names`, and the names of all schemas that they refer to."""
    found: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += re.findall(r"#/\$defs/(\w+)", str(schemas[name]))
    return found


def _references(names: tuple[str, ...]) -> dict[str, Any]:
    return {name: {"$ref": f"#/components/messages/{name}"} for name in names}


def _operation(action: str, channel: str, names: tuple[str, ...]) -> dict[str, Any]:
    """Return an operation of the service: it sends, or it receives."""
    return {
        "action": action,
        "channel": {"$ref": f"#/channels/{channel}"},
        "messages": [{"$ref": f"#/channels/{channel}/messages/{name}"} for name in names],
    }


def _message(name: str, schema: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": name,
        "summary": " ".join(schema.get("description", name).split()),
        "payload": {"$ref": f"#/components/schemas/{name}"},
    }


def _frame(layout: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": FRAME,
        "summary": "Consecutive samples of all channels of the last `Hello`, in binary.",
        "contentType": "application/octet-stream",
        "payload": {"type": "string", "format": "binary", "x-layout": layout},
    }
