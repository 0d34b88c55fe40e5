"""The class BinFolder: the bin of a recordings folder, which keeps deleted recordings for a while.

Each is in a folder of its own, named after the time of its deletion, so that its age is known without an index.
"""

import logging
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from config.errors import RefusedError

BIN_FOLDER = "bin"  # in the recordings folder, on the same disk, so that a move copies nothing
_ENTRY_TIME_FORMAT = "%Y%m%dT%H%M%S%fZ"
_ENTRY_PATTERN = re.compile(r"\d{8}T\d{12}Z")


@dataclass(frozen=True, slots=True)
class BinnedFile:
    """A deleted recording. `entry` is its name in the bin, `name` its original name."""

    entry: str
    path: Path
    deleted_at: datetime
    size_bytes: int

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def deleted_at_iso(self) -> str:
        """Time of deletion in the index's format."""
        return format_iso(self.deleted_at)


def format_iso(moment: datetime) -> str:
    return moment.isoformat(timespec="microseconds")


class BinFolder:
    """The bin of a recordings folder. Its methods block, and each may raise OSError."""

    def __init__(self, recordings: Path) -> None:
        self._recordings, self._folder = recordings, recordings / BIN_FOLDER

    def list_files(self) -> list[BinnedFile]:
        """Return the deleted recordings, last deleted first."""
        return sorted(self._iterate_files(), key=lambda file: file.entry, reverse=True)

    def add(self, path: Path, at: datetime) -> None:
        """Move a recording into the bin; `at` is the time of its deletion."""
        place = self._folder / f"{at.astimezone(UTC):{_ENTRY_TIME_FORMAT}}"
        place.mkdir(parents=True)
        try:
            path.rename(place / path.name)
        except OSError:
            place.rmdir()
            raise

    def find(self, entry: str) -> BinnedFile:
        """Return the deleted recording with this entry name.

        Raises:
            RefusedError: there is no such entry.
        """
        for file in self._iterate_files():
            if file.entry == entry:
                return file
        raise RefusedError(f"There is no entry {entry!r} in the bin. See the list of what is in it.", "entry")

    def restore(self, file: BinnedFile) -> Path:
        """Move a recording back and return its path.

        Raises:
            RefusedError: another recording has its name.
        """
        path = self._recordings / file.name
        if os.path.lexists(path):
            raise RefusedError(f"There is another recording {file.name!r} by now. Delete or rename that one first.")
        file.path.rename(path)
        file.path.parent.rmdir()
        return path

    def delete_permanently(self, file: BinnedFile) -> None:
        file.path.unlink(missing_ok=True)
        file.path.parent.rmdir()

    def _iterate_files(self) -> Iterator[BinnedFile]:
        for place in self._folder.glob("*"):
            if not _ENTRY_PATTERN.fullmatch(place.name) or not place.is_dir():
                continue
            try:
                at = datetime.strptime(place.name, _ENTRY_TIME_FORMAT).replace(tzinfo=UTC)
                for path in place.iterdir():
                    yield BinnedFile(place.name, path, at, path.lstat().st_size)
            except (OSError, ValueError) as error:  # it was removed meanwhile, or its name is no valid time
                logging.getLogger("graspwatch").info("the bin's %s is passed over: %s", place.name, error)


def find_expired(files: list[BinnedFile], keep_days: float, now: datetime) -> list[BinnedFile]:
    """Return those of the bin's `files` that were deleted more than `keep_days` ago."""
    return [file for file in files if now - file.deleted_at > timedelta(days=keep_days)]
