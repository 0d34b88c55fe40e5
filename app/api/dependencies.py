"""Dependencies of routes: one for each part of the service that routes use, and the renewal of control."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends
from starlette.requests import HTTPConnection

from app.analysis.calibration_session import CalibrationSession
from app.analysis.report.report_cache import ReportCache
from app.analysis.study_runner import StudyRunner
from app.api.recording_bin import RecordingBin
from app.http.idempotency import IdempotentAnswers
from app.http.methods import SAFE_METHODS
from app.messages.runs import Run
from app.people.authenticator import Authenticator
from app.people.authorization import get_user
from app.recordings.catalog import RecordingCatalog
from app.recordings.replay.cache_store import ReplayCacheStore
from app.service.configuration_files import ConfigurationFiles
from app.service.journal_watch import JournalWatch
from app.service.tool_service import ToolService


@dataclass(frozen=True, slots=True)
class Services:
    """The service's parts that live as long as the web application; its lifespan creates and closes them."""

    authenticator: Authenticator
    tool: ToolService
    calibration: CalibrationSession
    studies: StudyRunner
    replay_caches: ReplayCacheStore
    catalog: RecordingCatalog
    reports: ReportCache
    journal_watch: JournalWatch
    recording_bin: RecordingBin
    started_runs: IdempotentAnswers[Run]
    configuration_files: ConfigurationFiles


def _dependency(read: Callable[[Services], object]) -> Any:
    async def get(connection: HTTPConnection) -> object:  # FastAPI runs a plain function in a thread
        return read(connection.app.state.services)

    return Depends(get)


AuthenticatorDep = Annotated[Authenticator, _dependency(lambda services: services.authenticator)]
ToolServiceDep = Annotated[ToolService, _dependency(lambda services: services.tool)]
CalibrationDep = Annotated[CalibrationSession, _dependency(lambda services: services.calibration)]
StudiesDep = Annotated[StudyRunner, _dependency(lambda services: services.studies)]
ReplayCachesDep = Annotated[ReplayCacheStore, _dependency(lambda services: services.replay_caches)]
CatalogDep = Annotated[RecordingCatalog, _dependency(lambda services: services.catalog)]
ReportsDep = Annotated[ReportCache, _dependency(lambda services: services.reports)]
JournalWatchDep = Annotated[JournalWatch, _dependency(lambda services: services.journal_watch)]
RecordingBinDep = Annotated[RecordingBin, _dependency(lambda services: services.recording_bin)]
ConfigurationFilesDep = Annotated[ConfigurationFiles, _dependency(lambda services: services.configuration_files)]
StartedRunsDep = Annotated[IdempotentAnswers[Run], _dependency(lambda services: services.started_runs)]


async def renew_control(connection: HTTPConnection, tool_service: ToolServiceDep) -> None:
    """Renew the control lease of a user who changes something; without the lease, change nothing."""
    user = get_user(connection)
    if user and user.name and connection.scope.get("method", "GET") not in SAFE_METHODS:
        tool_service.control_lease.renew(user.name)
