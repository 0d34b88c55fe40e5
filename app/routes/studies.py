"""Studies: start, stop, look up, read the report."""

from http import HTTPStatus
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Body, Request
from fastapi.responses import FileResponse

from app.audit.deeds import note_deed
from app.people.roles import needs, signed
from app.problems import PROBLEM, ProblemError
from app.study.desk import StudyDesk
from app.wire import Role, StopRequest, Studies, StudyInfo, StudyRequest, StudyRun
from config.errors import ConfigurationError, RefusedError, ServiceError
from config.load import choose
from estimator.studies.catalogue import STUDIES, StudyEntry
from estimator.studies.page import POLICY

router = APIRouter(prefix="/api/studies", tags=["studies"])
NOT_FOUND = {404: {"description": "No such study, or nothing to show yet", **PROBLEM}}

# The sandbox makes the page a stranger to the dashboard, so that it could not stop a tool.
REPORT_POLICY = f"{POLICY}; sandbox allow-scripts allow-downloads"


def desk_of(request: Request) -> StudyDesk:
    return request.app.state.studies


@router.get("", dependencies=[needs(Role.VIEWER)])
async def list_studies(request: Request) -> Studies:
    """What can be studied, and what has been, newest first."""
    desk = desk_of(request)
    available = [
        StudyInfo(name=entry.name, title=entry.title, grasps=entry.usual, most_grasps=entry.most)
        for entry in STUDIES.values()
    ]
    return Studies(folder=str(desk.folder), available=available, runs=desk.all())


@router.post(
    "",
    dependencies=[needs(Role.OPERATOR)],
    status_code=HTTPStatus.CREATED,
    responses={
        409: {"description": "A study is under way", **PROBLEM},
        422: {"description": "A field is at fault", **PROBLEM},
        503: {"description": "The folder of studies cannot be written", **PROBLEM},
    },
)
async def start_study(request: Request, wanted: Annotated[StudyRequest, Body()]) -> StudyRun:
    """Start a study. It leaves one core to a live tool, and gives way to it on the others."""
    note_deed(request, what=f"Start study {wanted.study}, seed {wanted.seed}")
    entry = _entry(wanted.study)
    grasps = wanted.grasps or entry.usual
    if grasps > entry.most:
        detail = f"The study {entry.name} takes at most {entry.most}."
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, detail, "grasps")
    try:
        return desk_of(request).start(entry, grasps, wanted.seed, signed(request, wanted.by))
    except RefusedError as error:
        raise ProblemError(HTTPStatus.CONFLICT, str(error)) from None
    except ServiceError as error:
        raise ProblemError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from None


def _entry(name: str) -> StudyEntry:
    try:
        return STUDIES[choose(name, list(STUDIES), "study")]
    except ConfigurationError as error:
        raise ProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error), "study") from None


@router.get("/{study_id}", dependencies=[needs(Role.VIEWER)], responses=NOT_FOUND)
async def get_study(request: Request, study_id: str) -> StudyRun:
    """One study, with how far it is."""
    run = desk_of(request).get(study_id)
    if run is None:
        raise ProblemError(HTTPStatus.NOT_FOUND, f"There is no study {study_id!r}. GET /api/studies lists them.")
    return run


@router.post("/{study_id}/stop", dependencies=[needs(Role.OPERATOR)], responses=NOT_FOUND)
async def stop_study(request: Request, study_id: str, wanted: StopRequest | None = None) -> StudyRun:
    """Stop this study. Stopping one that is over changes nothing."""
    run = await get_study(request, study_id)
    return await desk_of(request).stop(run.id, "asked to stop", signed(request, wanted.by if wanted else None))


@router.get("/{study_id}/report", dependencies=[needs(Role.VIEWER)], response_class=FileResponse, responses=NOT_FOUND)
async def report(request: Request, study_id: str) -> FileResponse:
    """Its page, self-contained."""
    path = await _result(request, study_id, "html")
    return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": REPORT_POLICY})


@router.get("/{study_id}/figures", dependencies=[needs(Role.VIEWER)], response_class=FileResponse, responses=NOT_FOUND)
async def figures(request: Request, study_id: str) -> FileResponse:
    """Every figure and table of its page as JSON."""
    return FileResponse(await _result(request, study_id, "json"), media_type="application/json")


async def _result(request: Request, study_id: str, ending: str) -> Path:
    run = await get_study(request, study_id)
    path = desk_of(request).file(run, ending)
    if run.report is None:
        raise ProblemError(HTTPStatus.NOT_FOUND, f"Study {run.id} is {run.state.value}: it has no report.")
    if not path.is_file():
        raise ProblemError(
            HTTPStatus.NOT_FOUND, f"The report of study {run.id} is gone from {desk_of(request).folder}."
        )
    return path
