"""Routes to start, stop and look up studies, and to read their reports."""

from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Body, Request
from fastapi.responses import FileResponse

from app.analysis.study_runner import StudyRunner
from app.api.dependencies import StudiesDep
from app.http.audit_middleware import note_request
from app.http.problems import PROBLEM_RESPONSE, ProblemError
from app.messages.people import Role
from app.messages.runs import StopRequest
from app.messages.studies import Studies, StudyInfo, StudyRequest, StudyRun
from app.people.authorization import requester_name, require_role
from config.errors import ConfigurationError, RefusedError, ServiceError
from config.load import require_known_name
from estimator.studies.catalog import STUDIES, StudyDefinition
from estimator.studies.html_page import CONTENT_SECURITY_POLICY

router = APIRouter(prefix="/api/studies", tags=["studies"])
STUDY_NOT_FOUND_RESPONSE: dict[int | str, dict[str, Any]] = {
    404: {"description": "No such study, or nothing to show yet", **PROBLEM_RESPONSE}
}

# The sandbox gives the page an origin of its own, so that its script cannot send commands to the service.
REPORT_POLICY = f"{CONTENT_SECURITY_POLICY}; sandbox allow-scripts allow-downloads"


@router.get("", dependencies=[require_role(Role.VIEWER)])
async def list_studies(study_runner: StudiesDep) -> Studies:
    """List the available studies, and the studies that were started, newest first."""
    available = [
        StudyInfo(name=entry.name, title=entry.title, grasps=entry.default_count, most_grasps=entry.max_count)
        for entry in STUDIES.values()
    ]
    return Studies(folder=str(study_runner.folder), available=available, runs=study_runner.list_runs())


@router.post(
    "",
    dependencies=[require_role(Role.OPERATOR)],
    status_code=HTTPStatus.CREATED,
    responses={
        409: {"description": "A study is under way", **PROBLEM_RESPONSE},
        422: {"description": "A field is at fault", **PROBLEM_RESPONSE},
        503: {"description": "The folder of studies cannot be written", **PROBLEM_RESPONSE},
    },
)
async def start_study(request: Request, study_runner: StudiesDep, body: Annotated[StudyRequest, Body()]) -> StudyRun:
    """Start a study. It leaves one core free, and runs on the others with a lower priority than a live tool."""
    note_request(request, description=f"Start study {body.study}, seed {body.seed}")
    entry = _find_study(body.study)
    grasps = body.grasps or entry.default_count
    if grasps > entry.max_count:
        detail = f"The study {entry.name} takes at most {entry.max_count}."
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, detail, "grasps")
    try:
        return study_runner.start(entry, grasps, body.seed, requester_name(request, body.by))
    except RefusedError as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    except ServiceError as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None


def _find_study(name: str) -> StudyDefinition:
    try:
        return STUDIES[require_known_name(name, list(STUDIES), "study")]
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "study") from None


@router.get("/{study_id}", dependencies=[require_role(Role.VIEWER)], responses=STUDY_NOT_FOUND_RESPONSE)
async def get_study(study_runner: StudiesDep, study_id: str) -> StudyRun:
    """Return one study with its progress."""
    run = study_runner.get(study_id)
    if run is None:
        raise ProblemError(HTTPStatus.NOT_FOUND, f"There is no study {study_id!r}. See the list of studies.")
    return run


@router.post("/{study_id}/stop", dependencies=[require_role(Role.OPERATOR)], responses=STUDY_NOT_FOUND_RESPONSE)
async def stop_study(
    request: Request, study_runner: StudiesDep, study_id: str, body: StopRequest | None = None
) -> StudyRun:
    """Stop this study. Stopping a study that has ended changes nothing."""
    run = await get_study(study_runner, study_id)
    return await study_runner.stop(run.id, "asked to stop", requester_name(request, body.by if body else None))


@router.get(
    "/{study_id}/report",
    dependencies=[require_role(Role.VIEWER)],
    response_class=FileResponse,
    responses=STUDY_NOT_FOUND_RESPONSE
    | {200: {"description": "The page", "content": {"text/html": {"schema": {"type": "string"}}}}},
)
async def get_study_report(study_runner: StudiesDep, study_id: str) -> FileResponse:
    """Return the study's report as a self-contained HTML page."""
    path = await _find_result_file(study_runner, study_id, "html")
    return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": REPORT_POLICY})


@router.get(
    "/{study_id}/figures",
    dependencies=[require_role(Role.VIEWER)],
    response_class=FileResponse,
    responses=STUDY_NOT_FOUND_RESPONSE
    | {200: {"description": "The figures", "content": {"application/json": {"schema": {"type": "object"}}}}},
)
async def get_study_figures(study_runner: StudiesDep, study_id: str) -> FileResponse:
    """Return every figure and table of the study's report as JSON."""
    return FileResponse(await _find_result_file(study_runner, study_id, "json"), media_type="application/json")


async def _find_result_file(study_runner: StudyRunner, study_id: str, ending: str) -> Path:
    run = await get_study(study_runner, study_id)
    path = study_runner.result_path(run, ending)
    if run.report is None:
        raise ProblemError(HTTPStatus.NOT_FOUND, f"This study is {run.state.value}: it has no report.")
    if not path.is_file():
        raise ProblemError(HTTPStatus.NOT_FOUND, f"The report of this study is gone from {study_runner.folder}.")
    return path
