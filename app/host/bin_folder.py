"""The bin: recordings that were deleted, kept for a while beside the others.

Each lies in a folder of its own that is called after the moment of its deletion, so its age is known without an index.
"""

import logging
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from config.errors import RefusedError

BIN_FOLDER = "bin"  # in the recordings folder: the same disk, so that nothing is copied
_ENTRY_TIME_FORMAT = "%Y%m%dT%H%M%S%fZ"
_ENTRY_PATTERN = re.compile(r"\d{8}T\d{12}Z")


@dataclass(frozen=True, slots=True)
class BinnedFile:
    """A deleted recording. `entry` is its name in the bin, `name` the one that it had."""

    entry: str
    path: Path
    deleted_at: datetime
    size_bytes: int

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def deleted_at_iso(self) -> str:
        """As the index has it."""
        return format_iso(self.deleted_at)


def format_iso(moment: datetime) -> str:
    return moment.isoformat(timespec="microseconds")


class BinFolder:
    """That of a recordings folder. Blocks; every method may raise OSError."""

    def __init__(self, recordings: Path) -> None:
        self._recordings, self._folder = recordings, recordings / BIN_FOLDER

    def list_files(self) -> list[BinnedFile]:
        """What is in it, deleted last first."""
        return sorted(self._iterate_files(), key=lambda file: file.entry, reverse=True)

    def add(self, path: Path, at: datetime) -> None:
        """Move a recording into the bin; `at` is the moment of its deletion."""
        place = self._folder / f"{at.astimezone(UTC):{_ENTRY_TIME_FORMAT}}"
        place.mkdir(parents=True)
        try:
            path.rename(place / path.name)
        except OSError:
            place.rmdir()
            raise

    def find(self, entry: str) -> BinnedFile:
        """
        Raises:
            RefusedError: there is no such entry.
        """
        for file in self._iterate_files():
            if file.entry == entry:
                return file
        raise RefusedError(f"There is no entry {entry!r} in the bin. GET /api/bin lists them.", "entry")

    def restore(self, file: BinnedFile) -> Path:
        """Move it back; where to.

        Raises:
            RefusedError: there is a recording of its name.
        """
        path = self._recordings / file.name
        if os.path.lexists(path):
            raise RefusedError(f"There is another recording {file.name!r} by now. Delete or rename that one first.")
        file.path.rename(path)
        file.path.parent.rmdir()
        return path

    def delete_permanently(self, file: BinnedFile) -> None:
        """For good."""
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
            except (OSError, ValueError) as error:  # it went meanwhile, or is called after no moment at all
                logging.getLogger("graspwatch").info("the bin's %s is passed over: %s", place.name, error)


def find_expired(files: list[BinnedFile], keep_days: float, now: datetime) -> list[BinnedFile]:
    """Those that were deleted more than `keep_days` ago."""
    return [file for file in files if now - file.deleted_at > timedelta(days=keep_days)]
