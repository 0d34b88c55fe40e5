"""Routes to list, download, delete, report on and replay recordings."""

import contextlib
from dataclasses import asdict
from datetime import datetime
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response, WebSocket
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse

from app.api.dependencies import CatalogDep, RecordingBinDep, ReplayCachesDep, ReportsDep, ToolServiceDep
from app.api.routes.studies import REPORT_POLICY
from app.http.audit_middleware import describe_client, note_request
from app.http.pagination import set_paging_headers
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.index.queries import RecordingQuery
from app.index.store import RunSummary
from app.messages.base import PersonName
from app.messages.journal import Result
from app.messages.people import Role
from app.messages.recordings import RecordingInfo, Recordings, ReportProgress
from app.people.authorization import require_requester_name, require_role
from app.recordings.catalog import RecordingCatalog
from app.recordings.replay.cache_store import ReplayCacheStore
from app.recordings.replay.player import ReplayConnection, close_with_error
from app.service.tool_service import ToolService
from app.stream.viewers import Viewer
from config.errors import GraspwatchError, RecordingError, RefusedError, ServiceError

router = APIRouter(prefix="/api/recordings", tags=["recordings"])
WAITING_PAGE = Path(__file__).with_name("waiting.html")
WAITING_PAGE_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src 'self'"
)


@router.get("", dependencies=[require_role(Role.VIEWER)])
async def list_recordings(
    request: Request,
    tool_service: ToolServiceDep,
    catalog: CatalogDep,
    response: Response,
    query: Annotated[RecordingQuery, Query()],
) -> Recordings:
    """List recordings that can be replayed. A duration is null until its file has been read: ask again in a second."""
    listing = await catalog.list_recordings(read_new=request.method != "HEAD")
    summaries: dict[str, RunSummary] = {}
    with contextlib.suppress(ServiceError):  # without the index the files are still there
        run_ids = [each.run_id for each in listing.recordings if each.run_id]
        summaries = await tool_service.index_writer.query(tool_service.index_writer.store.summarize_runs, run_ids)
    described = [_add_summary(each, summaries.get(each.run_id or "")) for each in listing.recordings]
    found = [recording for recording in described if _matches(recording, query)]
    limit = query.limit or max(len(found), 1)
    set_paging_headers(request, response, limit, query.offset, len(found))
    return listing.model_copy(update={"recordings": found[query.offset : query.offset + limit]})


def _add_summary(recording: RecordingInfo, summary: RunSummary | None) -> RecordingInfo:
    return recording.model_copy(update=asdict(summary)) if summary else recording


def _matches(recording: RecordingInfo, query: RecordingQuery) -> bool:
    """Return whether the times fit, and each word of the text is in something that the list shows."""
    recorded = datetime.fromisoformat(recording.recorded_at)
    shown = [recording.name, recording.protocol, recording.tissue, recording.by, recording.subject]
    text = " ".join(filter(None, [*shown, *recording.labels, *recording.held])).replace("_", " ").casefold()
    words = (query.q or "").replace("_", " ").casefold().split()
    return (
        all(word in text for word in words)
        and (query.since is None or recorded >= query.since)
        and (query.until is None or recorded < query.until)
    )


@router.get(
    "/{name}/file",
    dependencies=[require_role(Role.VIEWER)],
    response_class=FileResponse,
    responses={
        200: {
            "description": "The whole file",
            "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
        },
        206: {"description": "The part that `Range` asked for"},
        404: {"description": "No such recording", **PROBLEM_RESPONSE},
        416: {"description": "There is no such part"},
    },
)
async def download_recording(catalog: CatalogDep, name: str) -> FileResponse:
    """Return the recording's file, or a part of it (`Range`, `If-Range`)."""
    return FileResponse(await _find_path(catalog, name), media_type="application/octet-stream", filename=name)


async def _find_path(catalog: RecordingCatalog, name: str) -> Path:
    try:
        return await catalog.find_path(name)
    except RefusedError as error:
        raise ProblemError(HTTPStatus.NOT_FOUND, str(error)) from None


@router.delete(
    "/{name}",
    dependencies=[require_role(Role.ADMIN)],
    status_code=HTTPStatus.NO_CONTENT,
    responses={
        403: {"description": "Not an admin", **PROBLEM_RESPONSE},
        404: {"description": "No such recording", **PROBLEM_RESPONSE},
        409: {"description": "In use", **PROBLEM_RESPONSE},
        503: {"description": "It cannot be deleted, or not be written down", **PROBLEM_RESPONSE},
    },
)
async def delete_recording(
    request: Request,
    recording_bin: RecordingBinDep,
    tool_service: ToolServiceDep,
    catalog: CatalogDep,
    cache_store: ReplayCachesDep,
    name: str,
    by: Annotated[
        PersonName | None, Query(description="Name of the requester; a signed-in user may leave it out")
    ] = None,
) -> None:
    """Move a recording into the bin; only an admin may. It can be restored until it expires.

    The journal and the index record who deleted it.
    """
    note_request(request, description=f"Delete {name}")
    by = require_requester_name(request, by)
    path = await _find_path(catalog, name)
    _check_not_in_use(tool_service, catalog, cache_store, path)
    await recording_bin.delete(path, by)


def _check_not_in_use(
    tool_service: ToolService, catalog: RecordingCatalog, cache_store: ReplayCacheStore, path: Path
) -> None:
    if Path(tool_service.recorder_link.state.file or "").name == path.name:
        why = "it is being recorded. Stop the run first."
    elif catalog.is_opened(path):
        why = "it was opened on the command line. End that service first."
    elif cache_store.is_watched(path):
        why = "somebody is watching it. Close its replay first."
    else:
        return
    raise ProblemError(HTTPStatus.CONFLICT, f"{path.name} is in use: {why}")


@router.get(
    "/{name}/report",
    dependencies=[require_role(Role.VIEWER)],
    response_class=HTMLResponse,
    responses={
        200: {"description": "The page, self-contained"},
        202: {
            "description": "It is being made: how far it is; a browser gets a page that waits for it",
            "content": {"application/json": {"schema": {"$ref": "#/components/schemas/ReportProgress"}}},
        },
        404: {"description": "No such recording", **PROBLEM_RESPONSE},
        422: {"description": "The recording cannot be read", **PROBLEM_RESPONSE},
        503: {"description": "Too many reports are being made", **PROBLEM_RESPONSE},
    },
)
async def get_recording_report(
    request: Request, tool_service: ToolServiceDep, catalog: CatalogDep, reports: ReportsDep, name: str
) -> Response:
    """Return the recording's report. The first request makes it, which takes a second per half minute of recording.

    Repeat the request while the status is 202; a browser gets a page that does so.
    """
    path = await _find_path(catalog, name)
    note = partial(
        tool_service.journal.write_request, "report", f"Make report of {name}", client=describe_client(request)
    )
    try:
        if request.method == "HEAD":  # builds nothing
            made = await reports.find_report(path)
        else:
            made = await reports.request_report(path, partial(note, result=Result.DONE))
    except RecordingError as error:
        note(result=Result.FAILED, reason=str(error))
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error)) from None
    except RefusedError as error:
        note(result=Result.REFUSED, reason=str(error))
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None
    fresh = {"Cache-Control": "no-store", "Vary": "Accept"}
    if isinstance(made, Path):
        policy = {"Content-Security-Policy": REPORT_POLICY}
        return FileResponse(made, media_type="text/html", headers=fresh | policy)
    if "text/html" in request.headers.get("accept", ""):
        policy = {"Content-Security-Policy": WAITING_PAGE_POLICY}
        return HTMLResponse(WAITING_PAGE.read_text(encoding="utf-8"), HTTPStatus.ACCEPTED, fresh | policy)
    return JSONResponse(ReportProgress(done=made or 0.0).model_dump(), HTTPStatus.ACCEPTED, fresh)


@router.websocket("/{name}/replay", dependencies=[require_role(Role.VIEWER)])
async def replay_recording(
    socket: WebSocket, tool_service: ToolServiceDep, catalog: CatalogDep, cache_store: ReplayCachesDep, name: str
) -> None:
    """Stream a recording as if it were live, with pause, seek and speed; see app/messages/live.py."""
    server = tool_service.plan.settings.server
    await socket.accept()
    try:
        path = await catalog.find_path(name)
        if cache_store.viewers >= server.max_viewers:
            await socket.close(1013, "too many viewers; try again later")
            return
        with cache_store.open_entry(path) as showing:
            await ReplayConnection(tool_service.plan, name, showing, socket).serve()
    except GraspwatchError as error:
        viewer = Viewer(socket, server.chart_window_frames)
        close_with_error(viewer, error)
        await viewer.serve()
