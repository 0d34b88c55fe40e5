"""The class JournalFile, to which several programs may append at once, each line in its place in the chain."""

import contextlib
import errno
import fcntl
import gzip
import hashlib
import io
import os
import secrets
import time
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from app.audit.hash_chain import NEW_LINE, ChainLink, parse_link, seal_entry, sha256_hex
from app.messages.journal import JournalEntry, JournalKind
from config.errors import JournalError

MAX_LINE_BYTES = 2**20  # a line has a few thousand
LOCK_TIMEOUT_S = 0.1  # short, because the event loop waits while another program writes
READ_CHUNK_BYTES = 2**20
CHAIN_BEGIN_TEXT = "The chain of the journal begins"


class JournalFile:
    """`journal.jsonl` of a data folder."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "journal.jsonl"
        self._last_link: ChainLink | None = None
        self._last_file_state: tuple[int, int] | None = None  # inode and size after this program's last write

    def append(self, entry: JournalEntry) -> list[JournalEntry]:
        """Append an entry; return the written entries, among which a note about the chain may precede it.

        Raises:
            OSError: the line cannot be written in full; if a part was, a note before the next line says so.
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
        """Wait until all lines of the journal that were written so far are on the disk.

        Raises:
            OSError: the sync failed.
        """
        for path, flags in ((self.path, os.O_RDONLY), (self.path.parent, os.O_RDONLY | os.O_DIRECTORY)):
            file = os.open(path, flags | os.O_CLOEXEC)
            try:
                os.fsync(file)
            finally:
                os.close(file)

    @contextlib.contextmanager
    def _locked(self) -> Iterator[int]:
        """Open the file and lock it for this program."""
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
        """Open and lock the file; return None if another program writes, or the file was just rotated away."""
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
        """Find the chain's last link if it is not known; return a note that must precede the next line, if any."""
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
            last = self._last_link  # the file was shortened: the gap in the numbers must show that
        if last is None:
            return [_chain_start_entry(file, at, has_end=not fragment)]
        self._last_link = last
        text = f"A line of the journal was cut off here, after {len(torn)} bytes: the power failed or the disk was full"
        return [_chain_entry(at, text, torn=sha256_hex(torn))] if torn else []

    def _missing_newline(self, file: int) -> bytes:
        """Return a newline if the file's last line has none."""
        size = os.fstat(file).st_size
        return b"" if not size or os.pread(file, 1, size - 1) == NEW_LINE else NEW_LINE


def find_journals(data: Path) -> list[Path]:
    """Return the journal and its rotated files (`journal.jsonl.1`, `.2.gz`), oldest first."""

    def age(path: Path) -> tuple[int, int]:
        link = next(_read_links(path), None)
        return link.number if link else 0, path.stat().st_mtime_ns

    return sorted(data.glob("journal.jsonl*"), key=age)


def read_journal_lines(path: Path) -> Iterator[bytes]:
    """Yield the lines of a file, with their newlines.

    Raises:
        JournalError: the file cannot be read to its end.
    """
    try:
        with open_journal_for_reading(path) as file:
            while line := file.readline(MAX_LINE_BYTES):  # a longer line is not ours, and must not fill the memory
                yield line
    except (OSError, EOFError, zlib.error) as error:
        raise JournalError(f"{path}: cannot be read to its end ({error}). Allow reading, or copy it again.") from None


def open_journal_for_reading(path: Path) -> io.BufferedIOBase:
    """Open a file of the journal for reading, as bytes; a rotated one is unpacked."""
    return gzip.open(path) if path.name.endswith(".gz") else path.open("rb")


def _read_links(path: Path) -> Iterator[ChainLink]:
    """Yield the links of all chained lines, as far as the file can be read."""
    with contextlib.suppress(OSError, EOFError, zlib.error), open_journal_for_reading(path) as file:
        while line := file.readline(MAX_LINE_BYTES):
            if link := parse_link(line):
                yield link


def _chain_start_entry(file: int, at: str, *, has_end: bool) -> JournalEntry:
    """Build the first entry of a chain, with the hash of everything before it in the file."""
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


def _chain_entry(at: str, text: str, *, begins: str | None = None, torn: str | None = None) -> JournalEntry:
    return JournalEntry(at=at, kind=JournalKind.CHAIN, text=text, begins=begins, torn=torn)


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
    """Return the last complete line, and the unfinished one after it."""
    size = os.fstat(file).st_size
    *before, fragment = os.pread(file, MAX_LINE_BYTES, max(size - MAX_LINE_BYTES, 0)).split(NEW_LINE)
    return before[-1] if before else b"", fragment


def _find_newest_link(rotated: Iterable[Path]) -> ChainLink | None:
    """Return the newest link in the rotated files."""
    links = (link for path in rotated for link in _read_links(path))
    return max(links, key=lambda link: link.number, default=None)


def _write_all(file: int, content: bytes) -> None:
    while content:
        content = content[os.write(file, content) :]
