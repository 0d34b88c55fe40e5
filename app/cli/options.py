"""Shared parts of the commands: options, the data folder and its recordings, the progress bar, the error console."""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from acquisition.recordings.file_names import has_recording_suffix
from app.cli.console import error_console
from config.atomic_write import check_writable, write_atomically
from config.errors import ConfigurationError, RecordingError, build_write_error
from config.load import load_settings
from config.schema import Settings

LibraryOption = Annotated[
    str | None, typer.Option("--library", metavar="NAME|FILE", help="Tissue library: a shipped or own name, or a file.")
]
ToolOption = Annotated[
    str | None,
    typer.Option("--tool", metavar="NAME|FILE", help="`simulated`, `nidaq` (an NI board), an own name, or a file."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of a table.")]
SeedOption = Annotated[int, typer.Option(min=0, help="Of specimens and noise; the same seed gives the same grasps.")]
DataOption = Annotated[
    Path | None,
    typer.Option("--data", metavar="FOLDER", help="Recordings, journal, studies, own files; default: as configured."),
]
TlsCertOption = Annotated[
    Path | None, typer.Option("--tls-cert", metavar="FILE", help="Certificate (PEM) for https, with --tls-key.")
]
TlsKeyOption = Annotated[Path | None, typer.Option("--tls-key", metavar="FILE", help="The certificate's key (PEM).")]
DEFAULT_RECORDING_TOOL = "smart_tool_2013"
ConfigOption = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="Settings instead of config/graspwatch.toml.")
]


def locate_data_folder(folder_option: Path | None, settings: Settings) -> Path:
    """Return where the data folder is; it need not be there."""
    return (folder_option or Path(settings.data_folder)).resolve()


def find_data_folder(folder_option: Path | None, settings: Settings) -> Path:
    """Return the data folder for a command that only reads it, or changes what is there; it is never made.

    Raises:
        ConfigurationError: there is no such folder.
    """
    folder = locate_data_folder(folder_option, settings)
    if not folder.is_dir():
        raise ConfigurationError(f"{folder}: there is no such folder. Name the data folder with --data, or make it.")
    return folder


def prepare_data_folder(folder_option: Path | None, settings: Settings) -> Path:
    """Return the data folder, and make it if it is missing.

    Raises:
        ConfigurationError: the folder cannot be made or written to.
        ServiceError: the disk is full.
    """
    folder = locate_data_folder(folder_option, settings)
    try:
        for name in ("recordings", "studies"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        check_writable(folder)
    except OSError as error:
        text = f"{folder}: is no folder to keep data in ({error.strerror}). Name another with --data."
        raise build_write_error(text, error) from None
    return folder


def prepare_known_data_folder(folder_option: Path | None, settings: Settings) -> Path:
    """Return the data folder to write to: the configured one is made if it is missing, one of `--data` is there.

    Raises:
        ConfigurationError: there is no such folder, or it cannot be written to.
        ServiceError: the disk is full.
    """
    if folder_option:
        find_data_folder(folder_option, settings)
    return prepare_data_folder(folder_option, settings)


def find_recording_file(run: str, config: Path | None, data: Path | None) -> Path:
    """Find the file of a run by its path or, in the data folder, by its id.

    Raises:
        RecordingError: there is no such recording.
    """
    named = Path(run)
    if named.suffix.lower() == ".mcap" or named.exists():
        return named
    if has_recording_suffix(run):
        raise RecordingError(f"{run}: there is no such file. Check the path.")
    folder = find_data_folder(data, load_settings(config)) / "recordings"
    path = folder / f"{run}.mcap"
    if not path.is_file():
        raise RecordingError(f"There is no recording of a run {run!r} in {folder}. Name another folder with --data.")
    return path


def write_output(path: Path, text: str, option: str = "--out") -> None:
    """Write a file in the place that `option` names, whole or not at all.

    Raises:
        ConfigurationError: the file cannot be written.
        ServiceError: the disk is full.
    """
    with explain_write_errors(path, option):
        write_atomically(path, text)


@contextlib.contextmanager
def explain_write_errors(path: Path, option: str = "--out") -> Iterator[None]:
    """Convert the errors of writing to the place that `option` names.

    Raises:
        ConfigurationError: it cannot be written.
        ServiceError: the disk is full.
    """
    try:
        yield
    except OSError as error:
        text = f"{path}: cannot be written ({error.strerror}). Free some space, or name another place with {option}."
        raise build_write_error(text, error) from None


class ProgressBar:
    """A progress bar on the error output, if that is a terminal; call it with the amount done."""

    def __init__(self, title: str, total: float) -> None:
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        self._bar = Progress(*columns, console=error_console, transient=True, disable=not error_console.is_terminal)
        self._task = self._bar.add_task(title, total=total)
        self._due_s = 0.0

    def __enter__(self) -> "ProgressBar":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, done: float) -> None:
        if not self._bar.disable and time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + 0.1
            self._bar.update(self._task, completed=done)
