"""Studies that the service carries out, one at a time, and those that it and earlier services have carried out."""

import logging
import os
import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from app.study.process import Job, StudyProcess
from app.wire import StudyRun, StudyState
from config.errors import RefusedError, ServiceError
from estimator.studies.catalogue import StudyEntry

RECORD = "study.json"
log = logging.getLogger("graspwatch")


class StudyDesk:
    """Each study has a folder of its id, with its record, its page and its JSON. As a context it ends what runs."""

    def __init__(self, folder: Path, tell: Callable[[str, str | None], None]) -> None:
        """`tell(text, by)` hears what starts and ends; `by`: who asked for it."""
        self.folder = folder
        self._tell = tell
        self._runs = _read_records(folder)
        self._process: StudyProcess | None = None
        self._current_id: str | None = None
        self._asked_to_stop: tuple[str, str | None] | None = None  # why, by whom

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._current_id:
            await self.stop(self._current_id, "the service was ended")

    def all(self) -> list[StudyRun]:
        """Newest first."""
        return list(reversed(self._runs.values()))

    def get(self, study_id: str) -> StudyRun | None:
        return self._runs.get(study_id)

    def file(self, run: StudyRun, ending: str) -> Path:
        """Where its page (`html`) or its figures (`json`) are once it has finished."""
        return self.folder / run.id / f"study-{run.study}.{ending}"

    def start(self, entry: StudyEntry, grasps: int, seed: int, by: str | None) -> StudyRun:
        """Start a study.

        Raises:
            RefusedError: one is under way.
            ServiceError: the folder cannot be written, or the system has no room for a process.
        """
        if self._current_id:
            raise RefusedError(f"Study {self._current_id} is under way. Stop it first, or wait for its end.", "study")
        try:
            run = self._begin(entry, grasps, seed, by)
        except OSError as error:
            raise ServiceError(
                f"A study cannot be started in {self.folder} ({error.strerror}). Make room there, then start it again."
            ) from None
        self._runs[run.id], self._current_id, self._asked_to_stop = run, run.id, None
        self._tell(f"Study started: {entry.name}, {grasps} of each, seed {seed}", by)
        return run

    async def stop(self, study_id: str, why: str, by: str | None = None) -> StudyRun:
        """End a study and all its processes; one that is over stays as it is."""
        if study_id == self._current_id and self._process:
            self._asked_to_stop = why, by
            self._process.kill()
            await self._process.wait()
        return self._runs[study_id]

    def _begin(self, entry: StudyEntry, grasps: int, seed: int, by: str | None) -> StudyRun:
        now = datetime.now(UTC)
        study_id = self._new_folder(f"{now:%Y%m%d-%H%M%S}-{entry.name}")
        run = StudyRun(
            id=study_id, study=entry.name, title=entry.title, grasps=grasps, seed=seed, by=by,
            state=StudyState.RUNNING, done=0, of=None, started_at=now.isoformat(), ended_at=None, why=None, report=None,
        )  # fmt: skip
        try:
            _write_record(self.folder, run)
            job = Job(entry.name, grasps, seed, self.folder / study_id)
            self._process = StudyProcess(job, self._on_progress, self._on_end)
        except OSError:
            shutil.rmtree(self.folder / study_id, ignore_errors=True)  # it never was
            raise
        return run

    def _new_folder(self, name: str) -> str:
        """Make a folder that was not there; a second study of the same second gets a number."""
        study_id, number = name, 1
        while True:
            try:
                (self.folder / study_id).mkdir(parents=True)
                return study_id
            except FileExistsError:
                number += 1
                study_id = f"{name}-{number}"

    def _on_progress(self, done: int, of: int) -> None:
        self._change(done=done, of=of)

    def _on_end(self, why: str | None) -> None:
        by = None
        if why is None:
            state, report = StudyState.FINISHED, f"/api/studies/{self._current_id}/report"
        elif self._asked_to_stop:
            (why, by), state, report = self._asked_to_stop, StudyState.STOPPED, None
        else:
            state, report = StudyState.FAILED, None
        run = self._change(state=state, why=why, report=report, ended_at=datetime.now(UTC).isoformat())
        self._process = self._current_id = None
        try:
            _write_record(self.folder, run)
        except OSError as error:
            log.warning("The record of study %s cannot be written (%s): make room or mend it", run.id, error.strerror)
        self._tell(f"Study {state.value}: {run.study}" + (f" ({why})" if why else ""), by)

    def _change(self, **fields: object) -> StudyRun:
        assert self._current_id
        run = self._runs[self._current_id] = self._runs[self._current_id].model_copy(update=fields)
        return run


def _write_record(folder: Path, run: StudyRun) -> None:
    """Whole or not at all."""
    path = folder / run.id / RECORD
    part = path.with_suffix(".part")
    part.write_text(run.model_dump_json(indent=2) + "\n", encoding="utf-8")
    os.replace(part, path)


def _read_records(folder: Path) -> dict[str, StudyRun]:
    """What earlier services left, oldest first. What cannot be read is left out, and the log says so."""
    runs = []
    for path in folder.iterdir() if folder.is_dir() else ():
        if not path.is_dir():
            continue
        try:
            run = StudyRun.model_validate_json((path / RECORD).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else "it is damaged, or another version's"
            log.warning("The study in %s is left out: its %s cannot be read (%s)", path, RECORD, why)
            continue
        if run.id != path.name:
            log.warning("The study in %s is left out: by its %s it belongs into %r", path, RECORD, run.id)
            continue
        runs.append(_as_left(run))
    return {run.id: run for run in sorted(runs, key=lambda run: run.started_at)}


def _as_left(run: StudyRun) -> StudyRun:
    if run.state is not StudyState.RUNNING:
        return run
    why = "The service died while it was under way. Start it again."
    return run.model_copy(update={"state": StudyState.FAILED, "why": why})
