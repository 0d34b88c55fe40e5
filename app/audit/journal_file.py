"""The file of the journal: only ever appended to, by any number of programs at once, each line in its place."""

import contextlib
import errno
import fcntl
import gzip
import hashlib
import os
import secrets
import time
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO

from app.audit.hash_chain import NEW_LINE, ChainLink, parse_link, seal_entry, sha256_hex
from app.messages.wire import JournalEntry, JournalKind
from config.errors import JournalError

MAX_LINE_BYTES = 2**20  # a line has a few thousand
LOCK_TIMEOUT_S = 0.1  # for another program that is writing; the event loop waits meanwhile
READ_CHUNK_BYTES = 2**20
CHAIN_BEGIN_TEXT = "The chain of the journal begins"


class JournalFile:
    """`journal.jsonl` of a data folder."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "journal.jsonl"
        self._last_link: ChainLink | None = None
        self._last_file_state: tuple[int, int] | None = None  # the file and its size as this program left it

    def append(self, entry: JournalEntry) -> list[JournalEntry]:
        """Write one entry; returns what was written: before it there may be a word of the journal about itself.

        Raises:
            OSError: it cannot be written; a part of the line may be, which the next one tells of.
        """
        written = []
        with self._locked() as file:
            for each in [*self._recover_chain(file, entry.at), entry]:
                if each.begins is not None:
                    self._last_link = None
                chain = self._last_link.chain if self._last_link else secrets.token_hex(4)
                before = self._last_link.number if self._last_link else _count_lines(file)
                line, placed = seal_entry(each, chain, before + 1, self._last_link.hash if self._last_link else None)
                _write_all(file, self._missing_newline(file) + line + NEW_LINE)
                self._last_link = parse_link(line)
                self._last_file_state = _read_file_state(file)
                written.append(placed)
        return written

    def sync(self) -> None:
        """Wait until all that was written is on the disk.

        Raises:
            OSError: it cannot be.
        """
        for path, flags in ((self.path, os.O_RDONLY), (self.path.parent, os.O_RDONLY | os.O_DIRECTORY)):
            file = os.open(path, flags | os.O_CLOEXEC)
            try:
                os.fsync(file)
            finally:
                os.close(file)

    @contextlib.contextmanager
    def _locked(self) -> Iterator[int]:
        """The file, open and for this program alone."""
        end_s = time.monotonic() + LOCK_TIMEOUT_S
        while (file := self._try_lock()) is None:
            if time.monotonic() > end_s:
                raise BlockingIOError(errno.EWOULDBLOCK, "another program holds it")
            time.sleep(0.0005)
        try:
            yield file
        finally:
            os.close(file)

    def _try_lock(self) -> int | None:
        """None: another program writes, or the file was rotated away just now."""
        file = os.open(self.path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(file), self.path.stat()):
                return file
        except (BlockingIOError, FileNotFoundError):
            pass
        except BaseException:
            os.close(file)
            raise
        os.close(file)
        return None

    def _recover_chain(self, file: int, at: str) -> list[JournalEntry]:
        """Find out where the chain stands, unless it is known; what has to be said about it first."""
        if self._last_file_state == _read_file_state(file):
            return []
        whole, fragment = _read_last_lines(file)
        last = parse_link(fragment)
        torn = fragment if fragment and not last else b""
        last = last or parse_link(whole)
        if not whole:
            last = last or _find_newest_link(path for path in self.path.parent.glob(f"{self.path.name}?*"))
        elif not last:
            return [_chain_start_entry(file, at, has_end=not fragment)]
        if self._last_link and (last is None or self._last_link.number > last.number):
            last = self._last_link  # somebody shortened the file: what is missing now has to show
        if last is None:
            return [_chain_start_entry(file, at, has_end=not fragment)]
        self._last_link = last
        text = f"A line of the journal was cut off here, after {len(torn)} bytes: the power failed or the disk was full"
        return [_chain_entry(at, text, torn=sha256_hex(torn))] if torn else []

    def _missing_newline(self, file: int) -> bytes:
        """What a line needs before it where the one before has no end."""
        size = os.fstat(file).st_size
        return b"" if not size or os.pread(file, 1, size - 1) == NEW_LINE else NEW_LINE


def find_journals(data: Path) -> list[Path]:
    """The journal and what was rotated away (`journal.jsonl.1`, `.2.gz`), oldest first."""

    def age(path: Path) -> tuple[int, int]:
        link = next(_read_links(path), None)
        return link.number if link else 0, path.stat().st_mtime_ns

    return sorted(data.glob("journal.jsonl*"), key=age)


def read_journal_lines(path: Path) -> Iterator[bytes]:
    """Of one file, with their ends.

    Raises:
        JournalError: it cannot be read.
    """
    try:
        with open_journal(path) as file:
            while line := file.readline(
                MAX_LINE_BYTES
            ):  # a longer one is none of ours, and must not ask for all memory
                yield line
    except (OSError, EOFError, zlib.error) as error:
        raise JournalError(f"{path}: cannot be read to its end ({error}). Allow reading, or copy it again.") from None


def open_journal(path: Path) -> IO[bytes]:
    return gzip.open(path) if path.name.endswith(".gz") else path.open("rb")


def _read_links(path: Path) -> Iterator[ChainLink]:
    """Of all lines in a chain, as far as the file can be read."""
    with contextlib.suppress(OSError, EOFError, zlib.error), open_journal(path) as file:
        while line := file.readline(MAX_LINE_BYTES):
            if link := parse_link(line):
                yield link


def _chain_start_entry(file: int, at: str, *, has_end: bool) -> JournalEntry:
    """The first word of a chain; it vouches for what stands before it."""
    before, place, chained = hashlib.sha256(), 0, False
    while piece := os.pread(file, READ_CHUNK_BYTES, place):
        before.update(piece)
        chained = chained or b'"hash":"' in piece
        place += len(piece)
    if not has_end:
        before.update(NEW_LINE)
    lines = _count_lines(file)
    text = f"{CHAIN_BEGIN_TEXT} anew: its last line is damaged" if chained else CHAIN_BEGIN_TEXT
    return _chain_entry(
        at, f"{text}, after {lines} lines that are not in it" if lines else text, begins=before.hexdigest()
    )


def _chain_entry(at: str, text: str, **facts: str) -> JournalEntry:
    return JournalEntry(at=at, kind=JournalKind.CHAIN, text=text, **facts)


def _count_lines(file: int) -> int:
    lines, at, last = 0, 0, NEW_LINE
    while piece := os.pread(file, READ_CHUNK_BYTES, at):
        lines += piece.count(NEW_LINE)
        at += len(piece)
        last = piece[-1:]
    return lines + (last != NEW_LINE)


def _read_file_state(file: int) -> tuple[int, int]:
    found = os.fstat(file)
    return found.st_ino, found.st_size


def _read_last_lines(file: int) -> tuple[bytes, bytes]:
    """The last line with an end, and what stands after it without one."""
    size = os.fstat(file).st_size
    *before, fragment = os.pread(file, MAX_LINE_BYTES, max(size - MAX_LINE_BYTES, 0)).split(NEW_LINE)
    return before[-1] if before else b"", fragment


def _find_newest_link(rotated: Iterable[Path]) -> ChainLink | None:
    """Where the chain stands at the end of the files that were rotated away."""
    links = (link for path in rotated for link in _read_links(path))
    return max(links, key=lambda link: link.number, default=None)


def _write_all(file: int, content: bytes) -> None:
    while content:
        content = content[os.write(file, content) :]
