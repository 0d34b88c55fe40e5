"""The shelf: which recordings can be replayed."""

import asyncio
import stat
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from acquisition.recordings.container import Container
from acquisition.recordings.layout import RAW
from acquisition.recordings.playing import Recording, tool_of
from app.aside import Tell, run_aside
from app.plan import ServicePlan
from app.wire import RecordingInfo, Recordings
from config.errors import GraspwatchError, RecordingError, RefusedError
from config.schema import Tool

ENDINGS = (".mcap", ".lvm", ".lvm.gz")
ADVICE = "Ask for the list again."
READ_AT_ONCE = 50  # files: then those come first that are new meanwhile


@dataclass(frozen=True, slots=True)
class _File:
    """A file as it was found; another size or time of change makes it another one."""

    path: Path
    size_bytes: int
    modified_ns: int


@dataclass(frozen=True, slots=True)
class _Content:
    """What reading a file gave: its duration, or why it cannot be read."""

    duration_s: float | None = None
    problem: str | None = None
    facts: dict[str, str] = field(default_factory=dict)  # of the run, where the file knows one
    whole: bool = True


def open_recording(path: Path, tool: Tool) -> Recording:
    """Read a recording, to be played as fast as it goes.

    Raises:
        RecordingError: it cannot be read; names the file, without its folder, and the line.
    """
    try:
        return Recording(path, tool)
    except RecordingError as error:
        raise RecordingError(str(error).replace(str(path), path.name)) from None


def read_all(tell: Tell, files: list[_File], tool: Tool) -> None:
    """Read files one after the other; tells each with what was found."""
    for file in files:
        try:
            tell((file, _read(file.path, tool)))
        except RecordingError as error:
            tell((file, _Content(problem=str(error).replace(str(file.path), file.path.name))))


def _read(path: Path, tool: Tool) -> _Content:
    """What a file holds; of a whole MCAP file only its beginning and its end are read."""
    if path.suffix != ".mcap":
        return _Content(open_recording(path, tool).duration_s)
    container = Container(path)
    if container.complete:
        samples = container.message_counts.get(RAW, 0)
        return _Content(samples / tool_of(container).board.sample_rate_hz, facts=container.about)
    return _Content(open_recording(path, tool).duration_s, facts=container.about, whole=False)


class Shelf:
    """The recordings of the data folder, and those named on the command line, wherever they are."""

    def __init__(self, plan: ServicePlan) -> None:
        self._plan = plan
        self._opened = _by_name(plan.opened)
        self._contents: dict[_File, _Content] = {}
        self._reading: asyncio.Task[None] | None = None

    async def listing(self) -> Recordings:
        """At once what is known: those of the command line first, then the newest; the rest is read meanwhile."""
        files = await asyncio.to_thread(self._find)
        self._contents = {file: self._contents[file] for file in files.values() if file in self._contents}
        unread = [file for file in files.values() if file not in self._contents]
        if unread and (self._reading is None or self._reading.done()):
            self._reading = asyncio.create_task(self._read(unread[:READ_AT_ONCE]))
        return Recordings(
            folder=str(self._plan.recordings_folder), recordings=[self._info(*item) for item in files.items()]
        )

    async def path(self, name: str) -> Path:
        """The file of a recording: only what the list shows can be named.

        Raises:
            RefusedError: there is no such recording.
        """
        file = (await asyncio.to_thread(self._find)).get(name)
        if file is None:
            raise RefusedError(f"There is no recording {name!r}. GET /api/recordings lists them.", "name")
        return file.path

    def is_opened(self, path: Path) -> bool:
        """Whether it was named on the command line."""
        return path in self._opened.values()

    async def aclose(self) -> None:
        """End the reading."""
        if self._reading:
            self._reading.cancel()
            await asyncio.gather(self._reading, return_exceptions=True)

    def _find(self) -> dict[str, _File]:
        opened = {name: file for name, path in self._opened.items() if (file := _file(path))}
        folder = self._plan.recordings_folder.resolve()
        named = [path for path in folder.glob("*") if path.name.endswith(ENDINGS) and path.name.isprintable()]
        inside = [path for path in named if not path.is_symlink() or path.resolve().parent == folder]
        files = [file for path in inside if (file := _file(path))]
        files.sort(key=lambda file: file.modified_ns, reverse=True)
        return opened | {file.path.name: file for file in files if file.path.name not in opened}

    async def _read(self, unread: list[_File]) -> None:
        def keep(read: tuple[_File, _Content]) -> None:
            self._contents.update([read])

        try:
            await run_aside("shelf", read_all, unread, self._plan.recorded_with, told=keep, advice=ADVICE)
        except GraspwatchError as error:  # it died of the first that it did not tell of; the others come next time
            broken = [file for file in unread if file not in self._contents]
            self._contents |= dict.fromkeys(broken[:1], _Content(problem=str(error)))

    def _info(self, name: str, file: _File) -> RecordingInfo:
        content = self._contents.get(file, _Content())
        facts = content.facts
        modified = datetime.fromtimestamp(file.modified_ns / 1e9, UTC).isoformat(timespec="seconds")
        return RecordingInfo(
            name=name,
            size_bytes=file.size_bytes,
            modified_at=modified,
            duration_s=content.duration_s,
            problem=content.problem,
            whole=content.whole,
            run_id=facts.get("run_id"),
            protocol=facts.get("protocol"),
            tissue=facts.get("tissue") or None,
            by=facts.get("by") or None,
        )


def _by_name(paths: tuple[Path, ...]) -> dict[str, Path]:
    """Files by their names, those of equal names numbered."""
    named: dict[str, Path] = {}
    for path in dict.fromkeys(path.resolve() for path in paths):
        stem, dot, endings = path.name.partition(".")
        names = [path.name, *(f"{stem} ({n}){dot}{endings}" for n in range(2, len(paths) + 1))]
        named[next(name for name in names if name not in named)] = path
    return named


def _file(path: Path) -> _File | None:
    """None for what is no file, or is none any more."""
    try:
        found = path.stat()
    except OSError:
        return None
    return _File(path, found.st_size, found.st_mtime_ns) if stat.S_ISREG(found.st_mode) else None
