"""The class LibraryApprovals: which texts of tissue libraries a real tool may use; and functions for earlier texts.

An approval is of a text, by its SHA-256. So a library that is changed needs another one, and a text that is restored
has its own again. Shipped libraries need none. The file only grows.
"""

import hashlib
import os
from datetime import UTC, datetime
from pathlib import Path

from app.messages.named_files import LibraryApproval
from app.messages.stored import read_stored
from config.atomic_write import open_atomically
from config.errors import ConfigurationError, build_write_error
from config.load import CONFIG_DIR, list_files, read_file_text

APPROVALS_FILE = "library_approvals.jsonl"
VERSIONS_FOLDER = "versions"  # in the folder of the libraries: texts that were replaced or deleted
VERSION_DIGITS = 16


def compute_version(text: str) -> str:
    """Return the version of a file's text, which identifies it."""
    return _hash(text)[:VERSION_DIGITS]


def list_versions(libraries: Path, name: str) -> list[Path]:
    """Return the files of the texts of a library: the present one, if there is one, and the earlier ones."""
    current = libraries / f"{name}.toml"
    kept = [path for path in list_files(libraries / VERSIONS_FOLDER) if path.stem.rpartition("-")[0] == name]
    return [current, *kept] if current.is_file() else kept


def keep_version(path: Path) -> None:
    """Copy a library's file, with its time, before it is replaced or deleted; do nothing without a file of text.

    Raises:
        OSError: the copy cannot be written.
    """
    if not path.is_file():
        return
    try:
        version = compute_version(read_file_text(path))
    except ConfigurationError:
        return
    kept = path.parent / VERSIONS_FOLDER / f"{path.stem}-{version}.toml"
    kept.parent.mkdir(exist_ok=True)
    found = path.stat()
    with open_atomically(kept) as file:
        file.write(path.read_bytes())
    os.utime(kept, ns=(found.st_atime_ns, found.st_mtime_ns))


def read_saved_time(path: Path) -> str:
    """Return the time at which a file's text was saved, ISO 8601."""
    return datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(timespec="seconds")


class LibraryApprovals:
    """The approvals in one data folder."""

    def __init__(self, data: Path) -> None:
        self._path = data / APPROVALS_FILE
        self._known: tuple[tuple[int, int], list[LibraryApproval]] | None = None  # of the file's time and size

    def find(self, text: str) -> LibraryApproval | None:
        """Return the newest decision on a text; None if there is none.

        Raises:
            ConfigurationError: the approvals cannot be read.
        """
        digest = _hash(text)
        return next((each for each in reversed(self._read()) if each.sha256 == digest), None)

    def add(self, library: str, text: str, *, approved: bool, reason: str, by: str | None) -> LibraryApproval:
        """Store a decision on a text, and return it.

        Raises:
            ConfigurationError: the file cannot be written.
            ServiceError: the disk is full.
        """
        at = datetime.now(UTC).isoformat(timespec="seconds")
        decision = LibraryApproval(
            sha256=_hash(text), library=library, approved=approved, reason=reason.strip(), by=by, at=at
        )
        try:
            with self._path.open("ab+") as file:  # one write a line, so that two writers do not mix
                size = file.seek(0, os.SEEK_END)
                file.seek(max(size - 1, 0))
                torn = b"\n" if file.read(1) not in (b"", b"\n") else b""  # a line that a full disk cut off
                file.write(torn + decision.model_dump_json().encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise build_write_error(f"{self._path}: cannot be written ({error.strerror}).", error) from None
        return decision

    def check(self, path: Path, named: str) -> None:
        """Check that a real tool may use the library in a file, which the settings name so.

        Raises:
            ConfigurationError: it is not approved; the text says how to approve it.
        """
        if path.resolve().is_relative_to(CONFIG_DIR.resolve()):
            return
        found = self.find(read_file_text(path))
        if found is None or not found.approved:
            why = "is not approved" if found is None else f"is no longer approved ({found.reason})"
            raise ConfigurationError(
                f"The tissue library {named!r} {why} for a real tool. Judge it, and approve it: graspwatch library "
                f"approve {named} --data {self._path.parent} --reason TEXT. Or name a shipped library in the settings."
            )

    def _read(self) -> list[LibraryApproval]:
        """Return all decisions, oldest first; the file is read again only after a change."""
        try:
            state = self._path.stat()
            version = (state.st_mtime_ns, state.st_size)
            if self._known and self._known[0] == version:
                return self._known[1]
            lines = self._path.read_bytes().splitlines()
        except FileNotFoundError:
            return []
        except OSError as error:
            raise ConfigurationError(f"{self._path}: cannot be read ({error.strerror}). Mend its mode.") from None
        found = []
        for number, line in enumerate(lines, 1):
            try:
                found.append(read_stored(LibraryApproval, line))
            except ValueError:
                raise ConfigurationError(
                    f"{self._path}, line {number}: is no approval. Put a good copy of the file in its place, or delete "
                    "the line."
                ) from None
        self._known = version, found
        return found


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
