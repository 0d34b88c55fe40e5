"""The class ReportCache, which builds each report of the service once, one at a time, in a background process."""

import asyncio
import contextlib
import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from app import __version__
from app.host.background_process import SendMessage, run_in_background_process
from config.atomic_write import write_atomically
from config.errors import RecordingError, RefusedError
from config.schema import Settings, TissueLibrary, Tool
from config.service_plan import ServicePlan

RETRY_ADVICE = "Ask for the report again."
MAX_PAGES = 30  # of some megabytes each
MAX_PENDING_REPORTS = 8  # waiting or being built
PROGRESS_STEP = 0.01
PAGE_END, PAGE_END_BYTES = b"</html>", 20


@dataclass(slots=True)
class _ReportBuild:
    """A report that is being built, and its progress."""

    task: "asyncio.Task[None]"
    done_share: float = 0.0


class ReportCache:
    """Keeps report pages; a changed recording, configuration or version gets a new page."""

    def __init__(self, plan: ServicePlan) -> None:
        self._plan = plan
        self._builds: dict[Path, _ReportBuild] = {}
        self._build_lock = asyncio.Lock()
        configured = (plan.recording_tool, plan.library, plan.settings)
        self._configuration = "".join(each.model_dump_json() for each in configured) + __version__

    async def request_report(self, recording: Path, on_started: Callable[[], object] = lambda: None) -> Path | float:
        """Return the path of a recording's page; if there is none, build it in the background and return the share.

        Calls `on_started` if it starts a build.

        Raises:
            GraspwatchError: the last build failed; the next request starts a new one.
            RefusedError: too many reports are being built.
        """
        page = await asyncio.to_thread(self._page_path, recording)
        making = self._builds.get(page)
        if making and not making.task.done():
            return making.done_share
        if making:
            del self._builds[page]
            making.task.result()
        if await asyncio.to_thread(_is_whole, page):
            with contextlib.suppress(OSError):
                os.utime(page)  # eviction goes by the time of the last request
            return page
        if sum(not each.task.done() for each in self._builds.values()) >= MAX_PENDING_REPORTS:
            raise RefusedError(f"{MAX_PENDING_REPORTS} reports are being made already. Ask again in a minute.", "name")
        making = self._builds[page] = _ReportBuild(asyncio.create_task(self._build(recording, page)))
        on_started()
        making.task.add_done_callback(lambda task: task.cancelled() or task.exception())  # the next request raises it
        return making.done_share

    async def find_report(self, recording: Path) -> Path | None:
        """Return the path of a recording's report page; None if the page has not been built.

        Raises:
            RecordingError: the recording is gone.
        """
        page = await asyncio.to_thread(self._page_path, recording)
        return page if await asyncio.to_thread(_is_whole, page) else None

    def _page_path(self, recording: Path) -> Path:
        try:
            found = recording.stat()
        except OSError as error:
            raise RecordingError(f"{recording.name}: cannot be read ({error.strerror}).") from None
        identity = f"{recording.resolve()} {found.st_size} {found.st_mtime_ns} {self._configuration}"
        return self._plan.reports_folder / f"{_short_hash(str(recording.resolve()))}-{_short_hash(identity)}.html"

    async def discard(self, recording: Path) -> None:
        """Delete all pages of a recording, and cancel the builds of its pages."""
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
        """Delete the least recently read pages, to make room for a new one."""
        pages = sorted(self._plan.reports_folder.glob("*.html"), key=lambda page: page.stat().st_mtime, reverse=True)
        for page in pages[MAX_PAGES - 1 :]:
            page.unlink(missing_ok=True)

    async def aclose(self) -> None:
        """Cancel all builds."""
        tasks = [making.task for making in self._builds.values()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _is_whole(page: Path) -> bool:
    """Return whether there is a page with its end; one that a failing disk cut off is built anew."""
    try:
        with page.open("rb") as file:
            file.seek(max(page.stat().st_size - PAGE_END_BYTES, 0))
            return PAGE_END in file.read()
    except OSError:
        return False


def _short_hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:20]


# --- in the background process ------------------------------------------------------------------------------------


def build_report(
    send: SendMessage, recording: Path, tool: Tool, library: TissueLibrary, settings: Settings, page_path: Path
) -> None:
    """Build a recording's report and write its page; sends the share done.

    Raises:
        RecordingError: the recording cannot be read; the text names file and line.
        OSError: the page cannot be written.
    """
    from app.analysis.report.page import render_report_page  # a slow import
    from app.analysis.report.report import analyze_recordings, read_common_configuration

    told = 0.0

    def progress(share: float) -> None:
        nonlocal told
        if share >= told + PROGRESS_STEP:
            told = share
            send(share)

    try:
        library, settings = read_common_configuration([recording]) or (library, settings)
        report = analyze_recordings([recording], tool, library, settings, {}, progress)
    except RecordingError as error:
        raise RecordingError(str(error).replace(str(recording), recording.name)) from None
    text = render_report_page(report, progress)
    page_path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(page_path, text)
