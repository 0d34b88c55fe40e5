"""Routes for the files that are chosen by name: shipped and own protocols, tissue libraries and tool files."""

import asyncio
from http import HTTPStatus
from typing import Annotated, Any

from fastapi import APIRouter, Body, Query, Request
from starlette.requests import ClientDisconnect

from app.analysis.tool_draft import ColumnAnswers, send_draft_report
from app.api.dependencies import CalibrationDep, ConfigurationFilesDep, ToolServiceDep
from app.api.routes.control_lease import acquire_control
from app.api.routes.runs import check_has_tool
from app.host.background_process import run_in_background_process
from app.http.audit_middleware import note_read_only, note_request
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.messages.base import PersonName
from app.messages.named_files import (
    ApprovalRequest,
    DraftQuery,
    FileCheck,
    FileContent,
    FileList,
    FileRequest,
    FileText,
    LibraryApproval,
    LibraryVersion,
    RestoreRequest,
    ToolDraftReport,
)
from app.messages.people import Role
from app.messages.tool import ToolInfo
from app.people.authorization import check_role, requester_name, require_role
from app.service.configuration_files import ConfigurationFiles, NoSuchFileError
from app.stream.descriptions import build_tool_info
from config.errors import ConfigurationError, GraspwatchError, RefusedError, ServiceError
from config.load import FileKind

router = APIRouter(prefix="/api/configuration", tags=["configuration"])
DRAFT_PATH = "/api/configuration/tool/draft"
MAX_RECORDING_BYTES = 64 * 2**20
BINARY = {"type": "string", "format": "binary"}
_draft_lock = asyncio.Lock()  # one draft at a time, because each takes memory beside a live tool
RequesterQuery = Annotated[PersonName | None, Query(description="Who asks, where nobody is signed in")]
NOT_FOUND_RESPONSE: dict[int | str, dict[str, Any]] = {404: {"description": "No such file", **PROBLEM_RESPONSE}}
CONFLICT_RESPONSE: dict[int | str, dict[str, Any]] = {
    409: {"description": "It is shipped, in use or changed meanwhile; the text says what to do", **PROBLEM_RESPONSE}
}
UNWRITABLE_RESPONSE: dict[int | str, dict[str, Any]] = {
    503: {"description": "The data folder cannot be written", **PROBLEM_RESPONSE}
}


@router.get("", dependencies=[require_role(Role.VIEWER)])
def list_named_files(configuration_files: ConfigurationFilesDep) -> FileList:
    """List protocols, tissue libraries and tool files: the shipped ones, and the own ones with their faults."""
    return configuration_files.list_files()


@router.get("/{kind}/{name}", dependencies=[require_role(Role.VIEWER)], responses=NOT_FOUND_RESPONSE)
def get_named_file(configuration_files: ConfigurationFilesDep, kind: FileKind, name: str) -> FileContent:
    """Return a protocol, tissue library or tool file with its text, its faults and its preview."""
    try:
        return configuration_files.read(kind, name)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None


@router.post("/{kind}/check", dependencies=[require_role(Role.OPERATOR)])
def check_file(
    request: Request, configuration_files: ConfigurationFilesDep, kind: FileKind, body: Annotated[FileText, Body()]
) -> FileCheck:
    """Return the faults in the text of a protocol, tissue library or tool file, or its preview. Nothing is saved."""
    note_read_only(request)
    return configuration_files.check(kind, body.text)


@router.post(
    "/tool/draft",
    dependencies=[require_role(Role.ADMIN)],
    openapi_extra={"requestBody": {"content": {"application/octet-stream": {"schema": BINARY}}, "required": True}},
    responses={
        409: {"description": "Another recording is being looked at", **PROBLEM_RESPONSE},
        422: {"description": "The recording or an answer is at fault; the text says what", **PROBLEM_RESPONSE},
        503: {"description": "The process that reads it died, or a disk is full", **PROBLEM_RESPONSE},
    },
)
async def draft_tool_file(
    request: Request, tool_service: ToolServiceDep, query: Annotated[DraftQuery, Query()]
) -> ToolDraftReport:
    """Look at the columns of a recording, the body, and draft a tool file for it once they are named. Nothing is saved.

    The recording is a text with columns, a TDMS, MAT or Parquet file of at most 64 MiB; `file` gives its ending.
    """
    note_read_only(request)
    if _draft_lock.locked():
        raise ProblemError(HTTPStatus.CONFLICT, "Another recording is being looked at. Try again in a moment.")
    answers = ColumnAnswers(**query.model_dump(exclude={"file"}))
    found: list[ToolDraftReport] = []
    try:
        async with _draft_lock:
            wanted = await request.body(), query.file, answers, tool_service.plan.settings.conditioning
            await run_in_background_process(
                "draft", send_draft_report, *wanted, on_message=found.append, advice="Make the recording shorter."
            )
    except ClientDisconnect:
        raise ProblemError(HTTPStatus.BAD_REQUEST, "The recording did not come whole. Send it again.") from None
    except ServiceError as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None
    except GraspwatchError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error)) from None
    return found[0]


@router.post(
    "/{kind}",
    dependencies=[require_role(Role.OPERATOR)],
    status_code=HTTPStatus.CREATED,
    responses=CONFLICT_RESPONSE
    | UNWRITABLE_RESPONSE
    | {422: {"description": "The text has faults, one in each of `errors`", **PROBLEM_RESPONSE}},
)
def save_file(
    request: Request, configuration_files: ConfigurationFilesDep, kind: FileKind, body: Annotated[FileRequest, Body()]
) -> FileContent:
    """Save a text as an own file under the name in it. `replaces` names the version that it replaces.

    Only an admin saves tool files.
    """
    note_request(request, description=f"Save a {kind.display_name}", by=requester_name(request, body.by))
    _check_may_change(request, kind)
    found = configuration_files.check(kind, body.text)
    if found.problems:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, "; ".join(found.problems), "text", messages=found.problems)
    note_request(request, description=f"Save {kind.display_name} {found.name}")
    saved = configuration_files.save(kind, body.text, body.replaces)
    before = f" instead of {body.replaces}" if body.replaces else ""
    note_request(request, description=f"Save {kind.display_name} {found.name}, version {saved.version}{before}")
    return saved


@router.delete(
    "/{kind}/{name}",
    dependencies=[require_role(Role.OPERATOR)],
    responses=NOT_FOUND_RESPONSE | CONFLICT_RESPONSE | UNWRITABLE_RESPONSE,
)
def delete_file(
    request: Request, configuration_files: ConfigurationFilesDep, kind: FileKind, name: str, by: RequesterQuery = None
) -> FileList:
    """Delete an own file, and return the files that are left. Only an admin deletes tool files."""
    note_request(request, description=f"Delete {kind.display_name} {name}", by=requester_name(request, by))
    _check_may_change(request, kind)
    try:
        configuration_files.delete(kind, name)
    except NoSuchFileError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None
    return configuration_files.list_files()


def _check_may_change(request: Request, kind: FileKind) -> None:
    """Check that the requester may save and delete files of a kind: a tool file decides forces and limits.

    Raises:
        ProblemError: the kind is tool files, and the requester is no admin.
    """
    if kind is FileKind.TOOL:
        check_role(request, Role.ADMIN)


@router.get("/library/{name}/versions", dependencies=[require_role(Role.VIEWER)], responses=NOT_FOUND_RESPONSE)
def list_library_versions(configuration_files: ConfigurationFilesDep, name: str) -> list[LibraryVersion]:
    """List the texts of an own tissue library, the present one first, each with the newest decision on it."""
    try:
        return configuration_files.list_versions(name)
    except NoSuchFileError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None


@router.post(
    "/library/{name}/approval",
    dependencies=[require_role(Role.ADMIN)],
    status_code=HTTPStatus.CREATED,
    responses=NOT_FOUND_RESPONSE | UNWRITABLE_RESPONSE,
)
def approve_library(
    request: Request, configuration_files: ConfigurationFilesDep, name: str, body: Annotated[ApprovalRequest, Body()]
) -> LibraryApproval:
    """Approve one text of an own tissue library for real tools, or withdraw that; only an admin may.

    A running service goes on with its library; the next start with a real tool needs an approved one.
    """
    by = requester_name(request, body.by)
    what = "Approve" if body.approved else "Withdraw the approval of"
    note_request(request, description=f"{what} library {name}, version {body.version}: {body.reason}", by=by)
    text = _read_version(configuration_files, name, body.version)
    return configuration_files.approvals.add(name, text, approved=body.approved, reason=body.reason, by=by)


@router.post(
    "/library/{name}/restore",
    dependencies=[require_role(Role.OPERATOR)],
    status_code=HTTPStatus.CREATED,
    responses=NOT_FOUND_RESPONSE | CONFLICT_RESPONSE | UNWRITABLE_RESPONSE,
)
def restore_library(
    request: Request, configuration_files: ConfigurationFilesDep, name: str, body: Annotated[RestoreRequest, Body()]
) -> FileContent:
    """Save an earlier text of an own tissue library again, with the decision that it has.

    A service that uses this library goes on with the text that it has read; the next start takes the restored one.
    """
    by = requester_name(request, body.by)
    note_request(request, description=f"Restore library {name}, version {body.version}", by=by)
    text = _read_version(configuration_files, name, body.version)
    return configuration_files.save(FileKind.LIBRARY, text, body.replaces, is_restored=True)


def _read_version(configuration_files: ConfigurationFiles, name: str, version: str) -> str:
    """Return a text of an own library.

    Raises:
        ProblemError: there is no such text.
    """
    try:
        return configuration_files.read_version(name, version)
    except NoSuchFileError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None


@router.post(
    "/tool/{name}/use",
    dependencies=[require_role(Role.ADMIN)],
    responses=NOT_FOUND_RESPONSE
    | {409: {"description": "Not now, or not this file; the text says what to do", **PROBLEM_RESPONSE}},
)
async def use_tool_file(
    request: Request,
    configuration_files: ConfigurationFilesDep,
    calibration_session: CalibrationDep,
    tool_service: ToolServiceDep,
    name: str,
    by: RequesterQuery = None,
) -> ToolInfo:
    """Go on with the constants of another file of this tool; only an admin may. The motor is disarmed.

    The answer comes at once. The tool is ready again when its state is `idle`, some seconds later.
    """
    by = requester_name(request, by)
    note_request(request, description=f"Use tool file {name}", by=by)
    check_has_tool(tool_service)
    try:
        path = configuration_files.find_tool_file(name)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None
    acquire_control(request, tool_service)
    try:
        await calibration_session.use_tool_file(path, by)
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    return build_tool_info(tool_service.plan.tool)
