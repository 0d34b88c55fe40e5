"""The reports of the service's recordings: each made once, one at a time, in a process of its own, and then kept."""

import asyncio
import contextlib
import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from app import __version__
from app.aside import Tell, run_aside
from app.plan import ServicePlan
from config.errors import RecordingError, RefusedError
from config.schema import Settings, TissueLibrary, Tool

ADVICE = "Ask for the report again."
KEPT = 30  # pages of some megabytes
MOST_ASKED = 8  # that wait or are made at a time
STEP = 0.01


@dataclass(slots=True)
class _Making:
    """A report on its way, and how far it is."""

    task: "asyncio.Task[None]"
    share: float = 0.0


class Reports:
    """A recording that has changed, or another configuration or version, is another report."""

    def __init__(self, plan: ServicePlan) -> None:
        self._plan = plan
        self._makings: dict[Path, _Making] = {}
        self._one = asyncio.Lock()
        configured = (plan.recorded_with, plan.library, plan.settings)
        self._configuration = "".join(each.model_dump_json() for each in configured) + __version__

    async def ask(self, recording: Path, begun: Callable[[], object] = lambda: None) -> Path | float:
        """The page of a recording if it is there; else it is being made from now on, and this is the share done.

        `begun` hears if it was not being made before.

        Raises:
            GraspwatchError: it could not be made; the next time it is tried again.
            RefusedError: too many are being made.
        """
        page = await asyncio.to_thread(self._place, recording)
        making = self._makings.get(page)
        if making and not making.task.done():
            return making.share
        if making:
            del self._makings[page]
            making.task.result()
        if await asyncio.to_thread(page.is_file):
            with contextlib.suppress(OSError):
                os.utime(page)  # what is read is kept
            return page
        if sum(not each.task.done() for each in self._makings.values()) >= MOST_ASKED:
            raise RefusedError(f"{MOST_ASKED} reports are being made already. Ask again in a minute.", "name")
        making = self._makings[page] = _Making(asyncio.create_task(self._make(recording, page)))
        begun()
        making.task.add_done_callback(lambda task: task.cancelled() or task.exception())  # told when asked again
        return making.share

    def _place(self, recording: Path) -> Path:
        try:
            found = recording.stat()
        except OSError as error:
            raise RecordingError(f"{recording.name}: cannot be read ({error.strerror}).") from None
        identity = f"{recording.resolve()} {found.st_size} {found.st_mtime_ns} {self._configuration}"
        return self._plan.reports_folder / f"{_digest(str(recording.resolve()))}-{_digest(identity)}.html"

    async def forget(self, recording: Path) -> None:
        """Let go of all pages of a recording, also those that are being made."""
        beginning = f"{_digest(str(recording.resolve()))}-"
        for page in [page for page in self._makings if page.name.startswith(beginning)]:
            self._makings.pop(page).task.cancel()
        for page in await asyncio.to_thread(list, self._plan.reports_folder.glob(f"{beginning}*")):
            page.unlink(missing_ok=True)

    async def _make(self, recording: Path, page: Path) -> None:
        def told(share: float) -> None:
            if page in self._makings:  # else the recording was deleted meanwhile
                self._makings[page].share = share

        plan = self._plan
        async with self._one:
            await asyncio.to_thread(self._tidy)
            wanted = recording, plan.recorded_with, plan.library, plan.settings, page
            await run_aside("report", make_report, *wanted, told=told, advice=ADVICE)

    def _tidy(self) -> None:
        """Let go of the pages that nobody has read for longest."""
        pages = sorted(self._plan.reports_folder.glob("*.html"), key=lambda page: page.stat().st_mtime, reverse=True)
        for page in pages[KEPT - 1 :]:
            page.unlink(missing_ok=True)

    async def aclose(self) -> None:
        """End what is being made."""
        tasks = [making.task for making in self._makings.values()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:20]


# --- in the process -----------------------------------------------------------------------------------------------


def make_report(
    tell: Tell, recording: Path, tool: Tool, library: TissueLibrary, settings: Settings, page_path: Path
) -> None:
    """Make a recording's report and write its page; tells the share done.

    Raises:
        RecordingError: it cannot be read; names file and line.
        OSError: the page cannot be written.
    """
    from app.report.page import page  # takes a second
    from app.report.report import as_recorded, read_report, write_whole

    told = 0.0

    def progress(share: float) -> None:
        nonlocal told
        if share >= told + STEP:
            told = share
            tell(share)

    try:
        library, settings = as_recorded([recording]) or (library, settings)
        report = read_report([recording], tool, library, settings, {}, progress)
    except RecordingError as error:
        raise RecordingError(str(error).replace(str(recording), recording.name)) from None
    text = page(report, progress)
    page_path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(page_path, text)
