"""The class StudyRunner: the service's study under way, and those that it and earlier services carried out."""

import asyncio
import logging
import os
import shutil
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from app.host.background_process import SendMessage, run_in_background_process
from app.messages.stored import read_stored
from app.messages.studies import StudyRun, StudyState
from config.atomic_write import write_atomically
from config.errors import RefusedError, ServiceError
from estimator.studies.catalog import STUDIES, StudyDefinition

RECORD_FILE = "study.json"
PROGRESS_PERIOD_S = 0.1
RETRY_ADVICE = "Start it again with fewer grasps."
logger = logging.getLogger("graspwatch")


class StudyRunner:
    """Runs one study at a time, each in a folder named by its id; leaving the context stops the study under way."""

    def __init__(self, folder: Path, publish_event: Callable[[str, str | None], None]) -> None:
        """`publish_event(text, by)` is called when a study starts or ends; `by` is the requester, if known."""
        self.folder = folder
        self._publish_event = publish_event
        self._runs = _read_records(folder)
        self._task: asyncio.Task[None] | None = None
        self._current_id: str | None = None
        self._stop_request: tuple[str, str | None] | None = None  # reason and requester

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._current_id:
            await self.stop(self._current_id, "the service was ended")

    def list_runs(self) -> list[StudyRun]:
        """Return all studies, newest first."""
        return list(reversed(self._runs.values()))

    def get(self, study_id: str) -> StudyRun | None:
        return self._runs.get(study_id)

    def result_path(self, run: StudyRun, ending: str) -> Path:
        """Return the path of a finished study's page (`html`) or figures (`json`)."""
        return self.folder / run.id / f"study-{run.study}.{ending}"

    def start(self, entry: StudyDefinition, grasps: int, seed: int, by: str | None) -> StudyRun:
        """Start a study in a background process; return its description with id and state.

        Raises:
            RefusedError: another study is under way.
            ServiceError: the folder cannot be written.
        """
        if self._current_id:
            current = self._runs[self._current_id]
            by = f", started by {current.by}" if current.by else ""
            text = f"A study is under way: {current.title.rstrip('.')}{by}. Stop it first, or wait for its end."
            raise RefusedError(text, "study")
        try:
            run = self._create_run(entry, grasps, seed, by)
        except OSError as error:
            raise ServiceError(
                f"A study cannot be started in {self.folder} ({error.strerror}). Make room there, then start it again."
            ) from None
        self._runs[run.id], self._current_id, self._stop_request = run, run.id, None
        wanted = entry.name, grasps, seed, self.folder / run.id
        work = run_in_background_process("study", run_study, *wanted, on_message=self._on_progress, advice=RETRY_ADVICE)
        self._task = asyncio.create_task(work)
        self._task.add_done_callback(self._on_end)
        self._publish_event(f"Study started: {entry.name}, {grasps} of each, seed {seed}", by)
        return run

    async def stop(self, study_id: str, why: str, by: str | None = None) -> StudyRun:
        """Stop a study and all its processes; a study that has ended stays as it is."""
        if study_id == self._current_id and self._task:
            self._stop_request = why, by
            self._task.cancel()
            await asyncio.wait([self._task])
            await asyncio.sleep(0)  # lets `_on_end` run
        return self._runs[study_id]

    def _create_run(self, entry: StudyDefinition, grasps: int, seed: int, by: str | None) -> StudyRun:
        now = datetime.now(UTC)
        study_id = self._make_folder(f"{now:%Y%m%d-%H%M%S}-{entry.name}")
        run = StudyRun(
            id=study_id,
            study=entry.name,
            title=entry.title,
            grasps=grasps,
            seed=seed,
            by=by,
            state=StudyState.RUNNING,
            done=0,
            of=None,
            started_at=now.isoformat(),
            ended_at=None,
            why=None,
            report=None,
        )
        try:
            _write_record(self.folder, run)
        except OSError:
            shutil.rmtree(self.folder / study_id, ignore_errors=True)  # without a record it is no study
            raise
        return run

    def _make_folder(self, name: str) -> str:
        """Make a new folder and return its name; a second study in the same second gets a number."""
        study_id, number = name, 1
        while True:
            try:
                (self.folder / study_id).mkdir(parents=True)
            except FileExistsError:
                number += 1
                study_id = f"{name}-{number}"
            else:
                return study_id

    def _on_progress(self, progress: tuple[int, int]) -> None:
        done, of = progress
        self._update_run(done=done, of=of)

    def _on_end(self, task: asyncio.Task[None]) -> None:
        why, by, report = None, None, None
        if task.cancelled():
            (why, by), state = self._stop_request or ("the service was ended", None), StudyState.STOPPED
        elif error := task.exception():
            why, state = str(error), StudyState.FAILED
        else:
            state, report = StudyState.FINISHED, f"/api/studies/{self._current_id}/report"
        run = self._update_run(state=state, why=why, report=report, ended_at=datetime.now(UTC).isoformat())
        self._task = self._current_id = None
        try:
            _write_record(self.folder, run)
        except OSError as error:
            logger.warning(
                "The record of study %s cannot be written (%s): make room or mend it", run.id, error.strerror
            )
        self._publish_event(f"Study {state.value}: {run.study}" + (f" ({why})" if why else ""), by)

    def _update_run(self, **fields: object) -> StudyRun:
        assert self._current_id
        run = self._runs[self._current_id] = self._runs[self._current_id].model_copy(update=fields)
        return run


def _write_record(folder: Path, run: StudyRun) -> None:
    write_atomically(folder / run.id / RECORD_FILE, run.model_dump_json(indent=2) + "\n")


def _read_records(folder: Path) -> dict[str, StudyRun]:
    """Read the studies of earlier services, oldest first; a study that cannot be read is left out and logged."""
    runs = []
    for path in folder.iterdir() if folder.is_dir() else ():
        if not path.is_dir():
            continue
        try:
            run = read_stored(StudyRun, (path / RECORD_FILE).read_bytes())
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else "it is damaged, or another version's"
            logger.warning("The study in %s is left out: its %s cannot be read (%s)", path, RECORD_FILE, why)
            continue
        if run.id != path.name:
            logger.warning("The study in %s is left out: by its %s it belongs into %r", path, RECORD_FILE, run.id)
            continue
        runs.append(_mark_interrupted(run))
    return {run.id: run for run in sorted(runs, key=lambda run: run.started_at)}


def _mark_interrupted(run: StudyRun) -> StudyRun:
    if run.state is not StudyState.RUNNING:
        return run
    why = "The service died while it was under way. Start it again."
    return run.model_copy(update={"state": StudyState.FAILED, "why": why})


# --- in the background process ------------------------------------------------------------------------------------


def run_study(send: SendMessage, study: str, grasps: int, seed: int, folder: Path) -> None:
    """Carry out a study on all cores but one, and write its page and its JSON into `folder`; sends (done, of).

    Raises:
        GraspwatchError: the study failed.
        OSError: the folder cannot be written.
    """
    from estimator.studies.answer_course import StudyConditions  # a slow import

    jobs = max((os.cpu_count() or 1) - 1, 1)
    STUDIES[study].run(StudyConditions(), grasps, seed, _ProgressSender(send), jobs).write(folder)


class _ProgressSender:
    """A progress callback that sends at most ten times a second, so that sending does not slow the study down."""

    def __init__(self, send: SendMessage) -> None:
        self._send = send
        self._due_s = 0.0

    def __call__(self, done: int, of: int) -> None:
        if done in (0, of) or time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + PROGRESS_PERIOD_S
            self._send((done, of))
