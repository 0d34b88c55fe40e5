"""The function that rebuilds the index from all recordings and the journal, which hold the same messages.

The index does not know the format of a recording: a `RecordingReader` reads each kind.
"""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import URL, delete
from sqlalchemy.exc import DataError, IntegrityError
from sqlalchemy.orm import Session

from app.audit.journal_file import find_journals, open_journal_for_reading
from app.host.bin_folder import BinFolder, BinnedFile
from app.index.database import explain_database_errors, make_engine
from app.index.index_lock import IndexLock
from app.index.ingest import IndexedMessage, ingest
from app.index.store import Store
from app.index.tables import IndexTable
from app.messages.journal import JournalEntry
from app.messages.recordings import FileRecord
from app.messages.stored import read_stored
from config.errors import GraspwatchError, ServiceError

BEHIND_MARKER_FILE = "index.behind"  # in the data folder: messages were left out of the index
SQLITE_SUFFIXES = ("", "-wal", "-shm")


@dataclass(frozen=True, slots=True)
class RecordingReader:
    """Reader of recordings whose names end with `suffix`.

    `read_messages` yields a file's records in order, each with its run's id; at damage it raises RecordingError,
    and the messages before count. `read_file_record` returns the record of the file; the recorder gives the live index
    the same.
    """

    suffix: str
    read_messages: Callable[[Path], Iterator[tuple[str | None, IndexedMessage]]]
    read_file_record: Callable[[Path], FileRecord]


@dataclass(slots=True)
class RebuildResult:
    """Result of a rebuild."""

    recordings: int = 0
    lines: int = 0
    broken_lines: int = 0
    problems: list[str] = field(default_factory=list)
    backup_path: Path | None = None


def find_recordings(data: Path, readers: Iterable[RecordingReader]) -> dict[Path, RecordingReader]:
    """Return the recordings of a data folder by name, which is by age, with their readers."""
    files = sorted(path for path in (data / "recordings").glob("*") if path.is_file())
    return {path: reader for path in files for reader in readers if path.name.endswith(reader.suffix)}


def find_binned_recordings(
    data: Path, readers: Iterable[RecordingReader]
) -> dict[Path, tuple[BinnedFile, RecordingReader]]:
    """Return the recordings in the bin with their readers: after a restore their grasps have to be known."""
    files = reversed(BinFolder(data / "recordings").list_files())
    return {file.path: (file, reader) for file in files for reader in readers if file.name.endswith(reader.suffix)}


def rebuild(
    url: URL, data: Path, readers: Iterable[RecordingReader], progress: Callable[[float], None]
) -> RebuildResult:
    """Build the index anew and replace the old one as a whole; `progress` receives the share done.

    Raises:
        ServiceError: a service uses the index, or the new one cannot be written; the old one is unchanged.
    """
    try:
        rebuilt = (_rebuild_in_new_file if url.get_backend_name() == "sqlite" else _rebuild_in_place)(
            url, data, readers, progress
        )
        (data / BEHIND_MARKER_FILE).unlink(missing_ok=True)
    except OSError as error:
        raise ServiceError(
            f"The index cannot be rebuilt ({error.strerror}: {error.filename}). Make room or mend it; the old one is "
            "as it was."
        ) from None
    return rebuilt


def _rebuild_in_place(
    url: URL, data: Path, readers: Iterable[RecordingReader], progress: Callable[[float], None]
) -> RebuildResult:
    """Rebuild in one transaction."""
    with contextlib.closing(Store(url, exclusive=True)) as store:
        return _fill_store(store, data, readers, progress)


def _rebuild_in_new_file(
    url: URL, data: Path, readers: Iterable[RecordingReader], progress: Callable[[float], None]
) -> RebuildResult:
    """Rebuild in a file beside the old one, which may be damaged, and exchange them at the end."""
    place = Path(url.database or "")
    new = place.with_name(f"{place.name}.new")
    with IndexLock(make_engine(url), exclusive=True):
        _delete_database(new)  # of an interrupted rebuild
        try:
            with contextlib.closing(Store(url.set(database=str(new)), exclusive=True)) as store:
                rebuilt = _fill_store(store, data, readers, progress)
            rebuilt.backup_path = _replace_database(new, place)
        finally:
            _delete_database(new)
    return rebuilt


def _fill_store(
    store: Store, data: Path, readers: Iterable[RecordingReader], progress: Callable[[float], None]
) -> RebuildResult:
    rebuilt = RebuildResult()
    readers = tuple(readers)
    recordings, journals, binned = (
        find_recordings(data, readers),
        find_journals(data),
        find_binned_recordings(data, readers),
    )
    # the journal, with deletions and restores, after the bin; recordings last, because a file that exists is not
    # deleted
    sizes = {path: max(path.stat().st_size, 1) for path in [*binned, *journals, *recordings]}
    done, total = 0, sum(sizes.values())
    with explain_database_errors(store.url), store.write_transaction() as session:
        for table in reversed(IndexTable.metadata.sorted_tables):
            session.execute(delete(table))
        for path, size in sizes.items():
            if path in recordings:
                ingest_recording(session, path, recordings[path], rebuilt)
            elif path in binned:
                file, reader = binned[path]
                ingest_recording(session, path, reader, rebuilt, deleted_at=file.deleted_at_iso)
            else:
                _ingest_journal(session, path, rebuilt)
            session.expunge_all()
            done += size
            progress(done / total)
    return rebuilt


def ingest_recording(
    session: Session, path: Path, reader: RecordingReader, result: RebuildResult, deleted_at: str | None = None
) -> None:
    """Ingest a recording, as far as it can be read; add a fault to the result's problems instead of raising it.

    `deleted_at` is that of a recording in the bin, ISO 8601.
    """
    for part in (_iterate_messages, _iterate_file_record):
        try:
            for run_id, message in part(path, reader):
                if isinstance(message, FileRecord):
                    message = message.model_copy(update={"deleted_at": deleted_at})
                with session.begin_nested():
                    ingest(session, message, run_id)
        except (GraspwatchError, OSError, ValueError, OverflowError, TypeError, DataError, IntegrityError) as error:
            why = " ".join(str(error).split())
            result.problems.append(why if path.name in why else f"{path.name}: {why}")
    result.recordings += 1


def _iterate_messages(path: Path, reader: RecordingReader) -> Iterator[tuple[str | None, IndexedMessage]]:
    """Yield the messages; journal lines lose their place in the chain, which only this folder's journal may define."""
    for run_id, message in reader.read_messages(path):
        yield run_id, message.without_chain() if isinstance(message, JournalEntry) else message


def _iterate_file_record(path: Path, reader: RecordingReader) -> Iterator[tuple[str | None, IndexedMessage]]:
    yield None, reader.read_file_record(path)


# --- the journal -----------------------------------------------------------------------------------------------------


def parse_journal_lines(lines: Iterable[bytes]) -> Iterator[JournalEntry | None]:
    """Yield the lines of a journal; None for a broken one, such as the last before a power cut."""
    for line in lines:
        if line.strip():
            try:
                yield read_stored(JournalEntry, line)
            except ValueError:
                yield None


def _ingest_journal(session: Session, path: Path, result: RebuildResult) -> None:
    try:
        with open_journal_for_reading(path) as file:
            for entry in parse_journal_lines(file):
                result.lines += 1
                if entry is None:
                    result.broken_lines += 1
                    continue
                try:
                    with session.begin_nested():
                        ingest(session, entry)
                except (ValueError, OverflowError, DataError, IntegrityError):
                    result.broken_lines += 1
    except (OSError, EOFError) as error:
        result.problems.append(f"{path.name}: cannot be read to its end ({error})")


# --- files of SQLite --------------------------------------------------------------------------------------------------


def _replace_database(new: Path, place: Path) -> Path | None:
    """Replace an old index by a new one; return the old one's path, a name with the date, if there was one."""
    aside = None
    if place.exists():
        aside = place.with_name(f"{place.name}.{datetime.now(UTC):%Y%m%d-%H%M%S-%f}.bad")
        for part in SQLITE_SUFFIXES[1:]:  # a write-ahead log must never meet another database
            if os.path.exists(f"{place}{part}"):
                os.rename(f"{place}{part}", f"{aside}{part}")
        try:
            os.link(place, aside)  # so that there is an index at every moment
        except OSError:  # a file system without links
            os.rename(place, aside)
    os.replace(new, place)
    return aside


def _delete_database(path: Path) -> None:
    for part in (*SQLITE_SUFFIXES, ".lock"):
        Path(f"{path}{part}").unlink(missing_ok=True)
