"""The reports of the service's recordings: each made once, one at a time, in a process of its own, and then kept."""

import asyncio
import contextlib
import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from app import __version__
from app.host.background_process import SendMessage, run_in_background_process
from config.errors import RecordingError, RefusedError
from config.schema import Settings, TissueLibrary, Tool
from config.service_plan import ServicePlan

RETRY_ADVICE = "Ask for the report again."
MAX_PAGES = 30  # pages of some megabytes
MAX_PENDING_REPORTS = 8  # that wait or are made at a time
PROGRESS_STEP = 0.01


@dataclass(slots=True)
class _ReportBuild:
    """A report on its way, and how far it is."""

    task: "asyncio.Task[None]"
    done_share: float = 0.0


class ReportCache:
    """A recording that has changed, or another configuration or version, is another report."""

    def __init__(self, plan: ServicePlan) -> None:
        self._plan = plan
        self._builds: dict[Path, _ReportBuild] = {}
        self._build_lock = asyncio.Lock()
        configured = (plan.recording_tool, plan.library, plan.settings)
        self._configuration = "".join(each.model_dump_json() for each in configured) + __version__

    async def request_report(self, recording: Path, on_started: Callable[[], object] = lambda: None) -> Path | float:
        """The page of a recording if it is there; else it is being made from now on, and this is the share done.

        `begun` hears if it was not being made before.

        Raises:
            GraspwatchError: it could not be made; the next time it is tried again.
            RefusedError: too many are being made.
        """
        page = await asyncio.to_thread(self._page_path, recording)
        making = self._builds.get(page)
        if making and not making.task.done():
            return making.done_share
        if making:
            del self._builds[page]
            making.task.result()
        if await asyncio.to_thread(page.is_file):
            with contextlib.suppress(OSError):
                os.utime(page)  # what is read is kept
            return page
        if sum(not each.task.done() for each in self._builds.values()) >= MAX_PENDING_REPORTS:
            raise RefusedError(f"{MAX_PENDING_REPORTS} reports are being made already. Ask again in a minute.", "name")
        making = self._builds[page] = _ReportBuild(asyncio.create_task(self._build(recording, page)))
        on_started()
        making.task.add_done_callback(lambda task: task.cancelled() or task.exception())  # told when asked again
        return making.done_share

    def _page_path(self, recording: Path) -> Path:
        try:
            found = recording.stat()
        except OSError as error:
            raise RecordingError(f"{recording.name}: cannot be read ({error.strerror}).") from None
        identity = f"{recording.resolve()} {found.st_size} {found.st_mtime_ns} {self._configuration}"
        return self._plan.reports_folder / f"{_short_hash(str(recording.resolve()))}-{_short_hash(identity)}.html"

    async def discard(self, recording: Path) -> None:
        """Let go of all pages of a recording, also those that are being made."""
        beginning = f"{_short_hash(str(recording.resolve()))}-"
        for page in [page for page in self._builds if page.name.startswith(beginning)]:
            self._builds.pop(page).task.cancel()
        for page in await asyncio.to_thread(list, self._plan.reports_folder.glob(f"{beginning}*")):
            page.unlink(missing_ok=True)

    async def _build(self, recording: Path, page: Path) -> None:
        def told(share: float) -> None:
            if page in self._builds:  # else the recording was deleted meanwhile
                self._builds[page].done_share = share

        plan = self._plan
        async with self._build_lock:
            await asyncio.to_thread(self._evict)
            wanted = recording, plan.recording_tool, plan.library, plan.settings, page
            await run_in_background_process("report", build_report, *wanted, on_message=told, advice=RETRY_ADVICE)

    def _evict(self) -> None:
        """Let go of the pages that nobody has read for longest."""
        pages = sorted(self._plan.reports_folder.glob("*.html"), key=lambda page: page.stat().st_mtime, reverse=True)
        for page in pages[MAX_PAGES - 1 :]:
            page.unlink(missing_ok=True)

    async def aclose(self) -> None:
        """End what is being made."""
        tasks = [making.task for making in self._builds.values()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _short_hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:20]


# --- in the process -----------------------------------------------------------------------------------------------


def build_report(
    send: SendMessage, recording: Path, tool: Tool, library: TissueLibrary, settings: Settings, page_path: Path
) -> None:
    """Make a recording's report and write its page; tells the share done.

    Raises:
        RecordingError: it cannot be read; names file and line.
        OSError: the page cannot be written.
    """
    from app.analysis.report.page import render_report_page  # takes a second
    from app.analysis.report.report import read_common_configuration, read_report, write_atomically

    told = 0.0

    def progress(share: float) -> None:
        nonlocal told
        if share >= told + PROGRESS_STEP:
            told = share
            send(share)

    try:
        library, settings = read_common_configuration([recording]) or (library, settings)
        report = read_report([recording], tool, library, settings, {}, progress)
    except RecordingError as error:
        raise RecordingError(str(error).replace(str(recording), recording.name)) from None
    text = render_report_page(report, progress)
    page_path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(page_path, text)
