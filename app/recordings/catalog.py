"""The class RecordingCatalog: the recordings that can be replayed, with their summaries."""

import asyncio
import stat
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from acquisition.recordings.file_names import has_recording_suffix, remove_recording_suffix, to_printable
from acquisition.recordings.mcap_layout import RAW_TOPIC, RECORDED_AT_METADATA
from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import RecordingSource, read_recorded_tool
from app.host.background_process import SendMessage, run_in_background_process
from app.messages.recordings import RecordingInfo, Recordings
from config.errors import GraspwatchError, RecordingError, RefusedError
from config.schema import Tool
from config.service_plan import ServicePlan

RETRY_ADVICE = "Ask for the list again."
MAX_FILES_PER_READ = 50  # the next reading starts with files that are new meanwhile


@dataclass(frozen=True, slots=True)
class _CatalogFile:
    """A file as it was found; with another size or modification time it counts as another file."""

    path: Path
    size_bytes: int
    modified_ns: int


@dataclass(frozen=True, slots=True)
class _FileSummary:
    """Result of reading a file: its duration, or why it cannot be read."""

    duration_s: float | None = None
    problem: str | None = None
    metadata: dict[str, str] = field(default_factory=dict)  # of the run, if the file has it
    is_complete: bool = True


def open_recording(path: Path, tool: Tool) -> RecordingSource:
    """Open a recording unthrottled.

    Raises:
        RecordingError: it cannot be read; the text names the file without its folder, and the line.
    """
    try:
        return RecordingSource(path, tool)
    except RecordingError as error:
        raise RecordingError(str(error).replace(str(path), path.name)) from None


def send_file_summaries(send: SendMessage, files: list[_CatalogFile], tool: Tool) -> None:
    """Read files one after the other, in a background process; `send` a pair of file and summary for each."""
    for file in files:
        try:
            send((file, _read_file(file.path, tool)))
        except RecordingError as error:
            problem = str(error).replace(str(file.path), file.path.name)
            send((file, _FileSummary(problem=problem, is_complete=False)))


def _read_file(path: Path, tool: Tool) -> _FileSummary:
    """Return a file's summary; for a complete MCAP file only its beginning and end are read."""
    if path.suffix.lower() != ".mcap":
        return _FileSummary(open_recording(path, tool).duration_s)
    container = McapFile(path)
    if container.complete:
        samples = container.message_counts.get(RAW_TOPIC, 0)
        return _FileSummary(samples / read_recorded_tool(container).board.sample_rate_hz, metadata=container.metadata)
    return _FileSummary(open_recording(path, tool).duration_s, metadata=container.metadata, is_complete=False)


class RecordingCatalog:
    """The recordings of the data folder and those named on the command line."""

    def __init__(self, plan: ServicePlan) -> None:
        self._plan = plan
        self._opened_recordings = assign_names(plan.opened_recordings)
        self._summaries: dict[_CatalogFile, _FileSummary] = {}
        self._read_task: asyncio.Task[None] | None = None

    async def list_recordings(self, *, read_new: bool = True) -> Recordings:
        """Return the known recordings, the command line's first, then the newest.

        With `read_new`, files that were not read yet are read in the background.
        """
        files = await asyncio.to_thread(self._scan_files)
        self._summaries = {file: self._summaries[file] for file in files.values() if file in self._summaries}
        unread = [file for file in files.values() if file not in self._summaries]
        if read_new and unread and (self._read_task is None or self._read_task.done()):
            self._read_task = asyncio.create_task(self._read_in_background(unread[:MAX_FILES_PER_READ]))
        return Recordings(
            folder=str(self._plan.recordings_folder), recordings=[self._build_info(*item) for item in files.items()]
        )

    async def find_path(self, name: str) -> Path:
        """Return a recording's file; only names of the list are found.

        Raises:
            RefusedError: there is no such recording.
        """
        file = (await asyncio.to_thread(self._scan_files)).get(name)
        if file is None:
            raise RefusedError(f"There is no recording {name!r}. See the list of recordings.", "name")
        return file.path

    def is_opened(self, path: Path) -> bool:
        """Return whether the recording was named on the command line."""
        return path in self._opened_recordings.values()

    async def aclose(self) -> None:
        """Cancel the background reading."""
        if self._read_task:
            self._read_task.cancel()
            await asyncio.gather(self._read_task, return_exceptions=True)

    def _scan_files(self) -> dict[str, _CatalogFile]:
        opened = {name: file for name, path in self._opened_recordings.items() if (file := _stat_file(path))}
        folder = self._plan.recordings_folder.resolve()
        named = [path for path in folder.glob("*") if has_recording_suffix(path.name) and path.name.isprintable()]
        inside = [path for path in named if not path.is_symlink() or path.resolve().parent == folder]
        files = [file for path in inside if (file := _stat_file(path))]
        files.sort(key=lambda file: file.modified_ns, reverse=True)
        return opened | {file.path.name: file for file in files if file.path.name not in opened}

    async def _read_in_background(self, unread: list[_CatalogFile]) -> None:
        def keep(read: tuple[_CatalogFile, _FileSummary]) -> None:
            self._summaries.update([read])

        try:
            await run_in_background_process(
                "shelf", send_file_summaries, unread, self._plan.recording_tool, on_message=keep, advice=RETRY_ADVICE
            )
        except GraspwatchError as error:  # it died of the first file without a summary; the others are read next time
            broken = [file for file in unread if file not in self._summaries]
            self._summaries |= dict.fromkeys(broken[:1], _FileSummary(problem=str(error)))

    def _build_info(self, name: str, file: _CatalogFile) -> RecordingInfo:
        content = self._summaries.get(file, _FileSummary(is_complete=False))  # not read yet
        facts = content.metadata
        modified = datetime.fromtimestamp(file.modified_ns / 1e9, UTC).isoformat(timespec="seconds")
        return RecordingInfo(
            name=name,
            size_bytes=file.size_bytes,
            modified_at=modified,
            recorded_at=facts.get(RECORDED_AT_METADATA, modified),
            duration_s=content.duration_s,
            problem=content.problem,
            whole=content.is_complete,
            run_id=facts.get("run_id"),
            protocol=facts.get("protocol"),
            tissue=facts.get("tissue") or None,
            by=facts.get("by") or None,
        )


def assign_names(paths: tuple[Path, ...]) -> dict[str, Path]:
    """Return the files by name; equal names get a number."""
    named: dict[str, Path] = {}
    for path in dict.fromkeys(path.resolve() for path in paths):
        name = to_printable(path.name)
        stem = remove_recording_suffix(name)
        endings = name.removeprefix(stem)
        names = [name, *(f"{stem} ({n}){endings}" for n in range(2, len(paths) + 1))]
        named[next(name for name in names if name not in named)] = path
    return named


def _stat_file(path: Path) -> _CatalogFile | None:
    """Return the file's size and modification time, or None if it is no regular file or is gone."""
    try:
        found = path.stat()
    except OSError:
        return None
    return _CatalogFile(path, found.st_size, found.st_mtime_ns) if stat.S_ISREG(found.st_mode) else None
