"""Functions that describe the REST interface as OpenAPI, which the service answers at `/openapi.json`."""

from http import HTTPStatus
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute
from pydantic.alias_generators import to_camel

from app.api.examples import EXAMPLES
from app.http.problems import PROBLEM_RESPONSE
from app.messages.recordings import ReportProgress
from app.messages.system import Problem
from app.people.route_permissions import RoutePermissions

TAGS = [
    {"name": "runs", "description": "Start, stop and look up runs; arm and disarm the tool."},
    {"name": "control", "description": "Who may start runs: one operator at a time, where people have tokens."},
    {"name": "alarms", "description": "Present alarms, their acknowledgment, and the journal since the start."},
    {"name": "annotations", "description": "What people say of runs: ground truth of grasps, and marks."},
    {"name": "lab-sessions", "description": "Who is examined, by whom, and under which conditions."},
    {"name": "calibration", "description": "Calibrate the tool, one reading at a time."},
    {"name": "configuration", "description": "Own protocols, libraries and tool files, beside the shipped ones."},
    {"name": "tool", "description": "The tool, its protocols and tissues, and the health of the service."},
    {
        "name": "recordings",
        "description": "Download, replay, report on and delete recordings; the bin of deleted ones.",
    },
    {"name": "history", "description": "Grasps, alarms, recordings and journal lines of all runs, page by page."},
    {"name": "studies", "description": "Carry out studies of the estimator, and read their reports."},
    {"name": "session", "description": "Sign a browser in and out."},
    {"name": "system", "description": "Versions, machine and configuration of the service."},
]
REFUSAL_STATUSES = (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.TOO_MANY_REQUESTS)
REFERENCE = "#/components/schemas/"


def make_operation_id(route: APIRoute) -> str:
    """Return the name of the route's function in camel case: `start_run` gives `startRun`."""
    return to_camel(route.name)


def describe_api(app: FastAPI, permissions: RoutePermissions) -> None:
    """Add to the description of `app`: roles, refusals, the schema of problems, and an example of each body."""
    plain = app.openapi

    def described() -> dict[str, Any]:
        if app.openapi_schema is None:
            schema = plain()
            schema["components"]["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
            for path, operations in schema["paths"].items():
                for method, operation in operations.items():
                    role = permissions[method.upper(), path]
                    if role:
                        operation |= {"security": [{"token": []}], "x-role": role.value}
                        for status in REFUSAL_STATUSES:
                            operation["responses"].setdefault(
                                str(status.value), {"description": status.phrase, **PROBLEM_RESPONSE}
                            )
                    _describe_bodies(operation)
            _add_named_schemas(schema["components"]["schemas"])
        return app.openapi_schema or {}

    app.openapi = described


def _describe_bodies(operation: dict[str, Any]) -> None:
    """Replace FastAPI's own error for status 422, which is never sent, and add examples."""
    responses = operation["responses"]
    if "HTTPValidationError" in str(responses.get("422")):
        responses["422"] = {"description": "A field is at fault", **PROBLEM_RESPONSE}
    bodies = [operation.get("requestBody", {}), *responses.values()]
    for content in (content for body in bodies for content in body.get("content", {}).values()):
        example = _find_example(content.get("schema", {}))
        if example is not None:
            content["example"] = example


def _find_example(schema: dict[str, Any]) -> Any:
    """Return the example of the model that a schema names, as a list if the schema is a list of it."""
    if schema.get("type") == "array":
        example = _find_example(schema["items"])
        return None if example is None else [example]
    named = [schema, *schema.get("anyOf", ())]
    names = [each["$ref"].removeprefix(REFERENCE) for each in named if "$ref" in each]
    return EXAMPLES[names[0]].model_dump(mode="json") if names else None


def _add_named_schemas(schemas: dict[str, Any]) -> None:
    """Add the schemas that routes name instead of their models, and remove FastAPI's own error."""
    for model in (Problem, ReportProgress):
        schema = model.model_json_schema(ref_template=REFERENCE + "{model}", mode="serialization")
        schemas |= {name: each for name, each in schema.pop("$defs", {}).items() if name not in schemas}
        schemas[model.__name__] = schema
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
