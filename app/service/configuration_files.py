"""The class ConfigurationFiles: lists and checks protocols, libraries and tool files; saves and deletes own ones."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from app.messages.named_files import FileCheck, FileContent, FileList, LibraryVersion, NamedFile
from app.service.library_approvals import (
    LibraryApprovals,
    compute_version,
    keep_version,
    list_versions,
    read_saved_time,
)
from app.service.runs import RunRegistry
from app.stream.descriptions import build_library_info, build_protocol_info
from config.atomic_write import write_atomically
from config.errors import ConfigurationError, RefusedError, ServiceError
from config.load import (
    CONFIG_DIR,
    FILE_MODELS,
    FileKind,
    list_faults,
    list_files,
    list_shipped_names,
    load_file,
    load_own_file,
    parse_file,
    read_file_text,
)
from config.schema import GraspProtocol, TissueLibrary
from config.service_plan import ServicePlan

MAX_FILES = 1000  # of each kind


class NoSuchFileError(RefusedError):
    """There is no file of this kind and name."""


@dataclass(frozen=True, slots=True)
class _Summary:
    """What the list of files needs of one. `modified_ns` and `size` change with the file."""

    modified_ns: int
    size: int
    title: str | None
    problems: list[str]


class ConfigurationFiles:
    """Own files of one data folder and the shipped files. Its methods block; they may run in any thread."""

    def __init__(self, plan: ServicePlan, runs: RunRegistry, get_calibration_source: Callable[[], str]) -> None:
        """Prepare the files; `get_calibration_source` returns the tool file that the next calibration builds on."""
        self._plan, self._runs, self._get_calibration_source = plan, runs, get_calibration_source
        self._first_tool_source = plan.tool_source
        self.approvals = LibraryApprovals(plan.data_folder)
        self._lock = threading.Lock()  # from the check of a version until the file is written
        self._summaries: dict[Path, _Summary] = {}

    def list_files(self) -> FileList:
        """Return all files, the own ones of each kind first. A faulty file is listed with its faults."""
        files = [
            self._describe(kind, path, is_shipped)
            for kind in FileKind
            for is_shipped in (False, True)
            for path in list_files(self._folder(kind, is_shipped))
        ]
        return FileList(folder=str(self._plan.data_folder), files=files)

    def list_readable_protocols(self) -> tuple[tuple[Path, int], ...]:
        """Return the protocol files without faults, each with its modification time, ns; this tool may refuse some."""
        playable = []
        for is_shipped in (True, False):
            for path in list_files(self._folder(FileKind.PROTOCOL, is_shipped)):
                summary = self._summarize(FileKind.PROTOCOL, path, is_shipped)
                if summary.title is not None:
                    playable.append((path, summary.modified_ns))
        return tuple(playable)

    def read(self, kind: FileKind, name: str) -> FileContent:
        """Return a shipped or own file with its text, faults and preview.

        Raises:
            RefusedError: there is no such file, or it is no text.
        """
        path, is_shipped = self._find(kind, name)
        try:
            text = read_file_text(path)
        except ConfigurationError as error:
            raise RefusedError(str(error), "name") from None
        file = self._describe(kind, path, is_shipped)
        check = self.check(kind, text).model_copy(update={"problems": file.problems})
        return FileContent(**dict(check), file=file, text=text, version=compute_version(text))

    def check(self, kind: FileKind, text: str) -> FileCheck:
        """Return the faults of a text, and a preview if it has none."""
        try:
            loaded = parse_file(text, FILE_MODELS[kind], kind.display_name)
        except ConfigurationError as error:
            return FileCheck(problems=list_faults(error, kind.display_name), name=None, protocol=None, library=None)
        return FileCheck(
            problems=[],
            name=loaded.name,
            protocol=build_protocol_info(loaded, self._plan.tool) if isinstance(loaded, GraspProtocol) else None,
            library=build_library_info(loaded) if isinstance(loaded, TissueLibrary) else None,
        )

    def save(self, kind: FileKind, text: str, replaces: str | None, *, is_restored: bool = False) -> FileContent:
        """Write a valid text to the file of the name in it. `replaces` is the version of a file that exists.

        With `is_restored`, the file may be in use: the service goes on with what it has read.

        Raises:
            RefusedError: the name is that of a shipped file, or of a file in use, with another version or deleted.
            ServiceError: the file cannot be written.
        """
        name = self.check(kind, text).name
        assert name is not None, "the caller checks the text"
        if name in list_shipped_names(kind.folder):
            raise RefusedError(
                f"{name!r} is a shipped {kind.display_name}, which cannot be changed. Give yours another `name`."
            )
        folder = self._folder(kind)
        path = folder / f"{name}.toml"
        with self._lock:
            if path.exists():
                if not is_restored:
                    self._check_changeable(kind, path)
                if compute_version(_read_old_text(path)) != replaces:
                    raise RefusedError(
                        f"There is already an own {kind.display_name} {name!r}, or somebody has changed it. Open it "
                        "again and change that text, or give yours another `name`."
                    )
            elif replaces is not None:
                raise RefusedError(
                    f"There is no own {kind.display_name} {name!r} any more that this text could replace. Give yours "
                    "another `name`, or send it without `replaces`."
                )
            elif len(list_files(folder)) >= MAX_FILES:
                raise RefusedError(f"{folder} holds {MAX_FILES} files. Delete some first.")
            try:
                folder.mkdir(parents=True, exist_ok=True)
                if kind is FileKind.LIBRARY:
                    keep_version(path)
                write_atomically(path, text)
            except OSError as error:
                raise ServiceError(f"{path}: cannot be written ({error.strerror}). Mend the data folder.") from None
            return self.read(kind, name)

    def delete(self, kind: FileKind, name: str) -> None:
        """Delete an own file.

        Raises:
            NoSuchFileError: there is no such file.
            RefusedError: it is shipped or in use.
            ServiceError: the file cannot be deleted.
        """
        path, is_shipped = self._find(kind, name, own_first=True)
        if is_shipped:
            raise RefusedError(f"{name!r} is a shipped {kind.display_name}, which cannot be deleted.")
        with self._lock:
            self._check_changeable(kind, path)
            try:
                if kind is FileKind.LIBRARY:
                    keep_version(path)
                path.unlink(missing_ok=True)
                self._summaries.pop(path, None)
            except OSError as error:
                raise ServiceError(f"{path}: cannot be deleted ({error.strerror}). Mend the data folder.") from None

    def list_versions(self, name: str) -> list[LibraryVersion]:
        """Return the texts of an own library, newest first. A deleted library has those that are kept.

        Raises:
            NoSuchFileError: there is no own library of this name, and there was none.
            ConfigurationError: the approvals cannot be read.
        """
        folder = self._folder(FileKind.LIBRARY)
        paths = list_versions(folder, name)
        if not paths:
            raise NoSuchFileError(f"There is no own tissue library {name!r}. See the list of files.", "name")
        found = []
        for path in paths:
            text = _read_old_text(path)
            found.append(
                LibraryVersion(
                    version=compute_version(text),
                    saved_at=read_saved_time(path),
                    current=path.parent == folder,
                    approval=self.approvals.find(text),
                )
            )
        return sorted(found, key=lambda each: (each.current, each.saved_at), reverse=True)

    def read_version(self, name: str, version: str) -> str:
        """Return a text of an own library.

        Raises:
            NoSuchFileError: there is no such text.
        """
        for path in list_versions(self._folder(FileKind.LIBRARY), name):
            if compute_version(text := _read_old_text(path)) == version:
                return text
        raise NoSuchFileError(f"The library {name!r} has no version {version!r}. See its versions.", "version")

    def find_tool_file(self, name: str) -> Path:
        """Return the path of a tool file that can be loaded.

        Raises:
            RefusedError: there is no such file, or it has faults.
        """
        path, is_shipped = self._find(FileKind.TOOL, name)
        if problems := self._describe(FileKind.TOOL, path, is_shipped).problems:
            raise RefusedError("; ".join(problems), "name")
        return path

    def _folder(self, kind: FileKind, is_shipped: bool = False) -> Path:
        return (CONFIG_DIR if is_shipped else self._plan.data_folder) / kind.folder

    def _find(self, kind: FileKind, name: str, *, own_first: bool = False) -> tuple[Path, bool]:
        """Return the file of a name and whether it is shipped.

        A name means the shipped file if there is one (`find_file`). With `own_first`, it means the own one.
        """
        for is_shipped in (not own_first, own_first):
            for path in list_files(self._folder(kind, is_shipped)):
                if path.stem == name:
                    return path, is_shipped
        raise NoSuchFileError(f"There is no {kind.display_name} {name!r}. See the list of files.", "name")

    def _describe(self, kind: FileKind, path: Path, is_shipped: bool) -> NamedFile:
        summary = self._summarize(kind, path, is_shipped)
        approval, problems = None, summary.problems
        if kind is FileKind.LIBRARY and not is_shipped:
            try:
                approval = self.approvals.find(_read_old_text(path))
            except ConfigurationError as error:
                problems = [*problems, str(error)]
        return NamedFile(
            kind=kind,
            name=path.stem,
            title=summary.title,
            shipped=is_shipped,
            problems=problems,
            in_use=None if is_shipped else self._describe_use(kind, path),
            approval=approval,
        )

    def _summarize(self, kind: FileKind, path: Path, is_shipped: bool) -> _Summary:
        """Return title and problems of a file, which is read again only after a change."""
        try:
            found = path.stat()
        except OSError as error:
            return _Summary(0, 0, None, [f"cannot be read ({error.strerror})."])
        kept = self._summaries.get(path)
        if kept and (kept.modified_ns, kept.size) == (found.st_mtime_ns, found.st_size):
            return kept
        title, problems = None, []
        try:
            title = (load_file(path, FILE_MODELS[kind]) if is_shipped else load_own_file(path, kind)).title
        except ConfigurationError as error:
            problems = list_faults(error, str(path))
        summary = self._summaries[path] = _Summary(found.st_mtime_ns, found.st_size, title, problems)
        return summary

    def _check_changeable(self, kind: FileKind, path: Path) -> None:
        if use := self._describe_use(kind, path):
            raise RefusedError(use)

    def _describe_use(self, kind: FileKind, path: Path) -> str | None:
        """Return why an own file cannot be changed now, or None."""
        run, plan, settings = self._runs.current, self._plan, self._plan.settings
        if kind is FileKind.PROTOCOL and run and run.protocol == path.stem:
            return f"The run {run.id} plays this protocol. Wait for its end, or stop it."
        if kind is FileKind.LIBRARY and plan.library.name == path.stem:
            return "The service uses this library. Save yours under another `name`."
        if kind is FileKind.TOOL and _is_file(plan.tool_source, path):
            return "The service uses this tool file. Save yours under another `name`."
        if kind is FileKind.TOOL and _is_file(self._get_calibration_source(), path):
            return "The next calibration builds on this tool file. Save yours under another `name`."
        next_sources = {
            FileKind.TOOL: (settings.tool, self._first_tool_source),
            FileKind.LIBRARY: (settings.library,),
            FileKind.PROTOCOL: (),
        }[kind]
        if any(_is_file(source, path) for source in next_sources):
            return "The next start of the service uses this file again. Save yours under another `name`."
        return None


def _is_file(source: str, path: Path) -> bool:
    """Return whether a name or path, as a setting states it, means the own file `path`."""
    return source == path.stem or Path(source).resolve() == path.resolve()


def _read_old_text(path: Path) -> str:
    """Return the text of a file that is replaced; empty if it is no text."""
    try:
        return read_file_text(path)
    except ConfigurationError:
        return ""
