"""Build the index anew from the files: every recording, and the journal. The live index comes from the same messages.

The index does not know how a recording is written: a `Reader` for each kind says what is in it.
"""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from pydantic import ValidationError
from sqlalchemy import URL, delete
from sqlalchemy.exc import DataError, IntegrityError
from sqlalchemy.orm import Session

from app.audit.file import journals_in, open_journal
from app.bin import Bin, BinnedFile
from app.record.indexing import recorded_file, recorded_messages
from app.record.recorder import ENDING
from app.store.claim import Claim
from app.store.database import engine_of, faults_explained
from app.store.store import Store
from app.store.tables import Table
from app.store.taking import Indexed, take
from app.wire import FileRecord, JournalEntry
from config.errors import GraspwatchError, ServiceError

BEHIND_MARKER = "index.behind"  # in the data folder: something was left out of the index
SQLITE_PARTS = ("", "-wal", "-shm")


@dataclass(frozen=True, slots=True)
class Reader:
    """How recordings with one `ending` are read.

    `recorded_messages` gives the wire messages in a file in order, each with the run it belongs to; at a damaged place
    it raises RecordingError, and what came before counts. `recorded_file` says what the file as a whole is; the
    recorder gives the live index what it returns.
    """

    ending: str
    recorded_messages: Callable[[Path], Iterator[tuple[str | None, Indexed]]]
    recorded_file: Callable[[Path], FileRecord]


READERS = (Reader(ENDING, recorded_messages, recorded_file),)


@dataclass(slots=True)
class Rebuilt:
    """What a rebuild found."""

    recordings: int = 0
    lines: int = 0
    broken_lines: int = 0
    problems: list[str] = field(default_factory=list)
    set_aside: Path | None = None


def recordings_in(data: Path, readers: Iterable[Reader]) -> dict[Path, Reader]:
    """The recordings of a data folder and how each is read, by name, which is by age."""
    files = sorted(path for path in (data / "recordings").glob("*") if path.is_file())
    return {path: reader for path in files for reader in readers if path.name.endswith(reader.ending)}


def binned_in(data: Path, readers: Iterable[Reader]) -> dict[Path, tuple[BinnedFile, Reader]]:
    """The same of those in the bin: they can be restored, and then their grasps are to be known."""
    files = reversed(Bin(data / "recordings").files())
    return {file.path: (file, reader) for file in files for reader in readers if file.name.endswith(reader.ending)}


def rebuild(url: URL, data: Path, readers: Iterable[Reader], progress: Callable[[float], None]) -> Rebuilt:
    """Build the index anew and put it in the old one's place as a whole; `progress` hears the share that is done.

    Raises:
        ServiceError: a service uses the index, or the new one cannot be written: the old one is as it was.
    """
    try:
        rebuilt = (_in_new_file if url.get_backend_name() == "sqlite" else _in_place)(url, data, readers, progress)
        (data / BEHIND_MARKER).unlink(missing_ok=True)
    except OSError as error:
        raise ServiceError(
            f"The index cannot be rebuilt ({error.strerror}: {error.filename}). Make room or mend it; the old one is "
            "as it was."
        ) from None
    return rebuilt


def _in_place(url: URL, data: Path, readers: Iterable[Reader], progress: Callable[[float], None]) -> Rebuilt:
    """In one transaction."""
    with contextlib.closing(Store(url, alone=True)) as store:
        return _fill(store, data, readers, progress)


def _in_new_file(url: URL, data: Path, readers: Iterable[Reader], progress: Callable[[float], None]) -> Rebuilt:
    """Beside the old one, which may be damaged; the two are exchanged at the end."""
    place = Path(url.database or "")
    new = place.with_name(f"{place.name}.new")
    with Claim(engine_of(url), alone=True):
        _remove(new)  # of a rebuild that was broken off
        try:
            with contextlib.closing(Store(url.set(database=str(new)), alone=True)) as store:
                rebuilt = _fill(store, data, readers, progress)
            rebuilt.set_aside = _swap(new, place)
        finally:
            _remove(new)
    return rebuilt


def _fill(store: Store, data: Path, readers: Iterable[Reader], progress: Callable[[float], None]) -> Rebuilt:
    rebuilt = Rebuilt()
    readers = tuple(readers)
    recordings, journals, binned = recordings_in(data, readers), journals_in(data), binned_in(data, readers)
    # the journal knows who deleted what and what came back; and a recording that is there is not deleted
    sizes = {path: max(path.stat().st_size, 1) for path in [*binned, *journals, *recordings]}
    done, total = 0, sum(sizes.values())
    with faults_explained(store.url), store.writing() as session:
        for table in reversed(Table.metadata.sorted_tables):
            session.execute(delete(table))
        for path, size in sizes.items():
            if path in recordings:
                take_recording(session, path, recordings[path], rebuilt)
            elif path in binned:
                file, reader = binned[path]
                take_recording(session, path, reader, rebuilt, deleted_at=file.deleted_iso)
            else:
                _take_journal(session, path, rebuilt)
            session.expunge_all()
            done += size
            progress(done / total)
    return rebuilt


def take_recording(
    session: Session, path: Path, reader: Reader, rebuilt: Rebuilt, deleted_at: str | None = None
) -> None:
    """A recording that cannot be read to its end gives what it has; its fault is told, and the others go on.

    `deleted_at` is of one in the bin, ISO 8601.
    """
    for part in (_messages_of, _record_of):
        try:
            for run_id, message in part(path, reader):
                if isinstance(message, FileRecord):
                    message = message.model_copy(update={"deleted_at": deleted_at})
                with session.begin_nested():
                    take(session, message, run_id)
        except (GraspwatchError, OSError, ValueError, OverflowError, TypeError, DataError, IntegrityError) as error:
            why = " ".join(str(error).split())
            rebuilt.problems.append(why if path.name in why else f"{path.name}: {why}")
    rebuilt.recordings += 1


def _messages_of(path: Path, reader: Reader) -> Iterator[tuple[str | None, Indexed]]:
    """Of the journal without the place in it: that is only believed to this folder's own journal."""
    for run_id, message in reader.recorded_messages(path):
        yield run_id, message.unchained() if isinstance(message, JournalEntry) else message


def _record_of(path: Path, reader: Reader) -> Iterator[tuple[str | None, Indexed]]:
    yield None, reader.recorded_file(path)


# --- the journal -----------------------------------------------------------------------------------------------------


def read_lines(lines: Iterable[bytes]) -> Iterator[JournalEntry | None]:
    """The lines of a journal; None for one that is broken, such as the last before a power cut."""
    for line in lines:
        if line.strip():
            try:
                yield JournalEntry.model_validate_json(line)
            except ValidationError:
                yield None


def _take_journal(session: Session, path: Path, rebuilt: Rebuilt) -> None:
    try:
        with open_journal(path) as file:
            for entry in read_lines(file):
                rebuilt.lines += 1
                try:
                    if entry is None:
                        raise ValueError("broken")
                    with session.begin_nested():
                        take(session, entry)
                except (ValueError, OverflowError, DataError, IntegrityError):
                    rebuilt.broken_lines += 1
    except (OSError, EOFError) as error:
        rebuilt.problems.append(f"{path.name}: cannot be read to its end ({error})")


# --- files of SQLite --------------------------------------------------------------------------------------------------


def _swap(new: Path, place: Path) -> Path | None:
    """Put a new index in an old one's place. The old one stays, under a name with the date."""
    aside = None
    if place.exists():
        aside = place.with_name(f"{place.name}.{datetime.now(UTC):%Y%m%d-%H%M%S-%f}.bad")
        for part in SQLITE_PARTS[1:]:  # a write-ahead log must never meet another database
            if os.path.exists(f"{place}{part}"):
                os.rename(f"{place}{part}", f"{aside}{part}")
        try:
            os.link(place, aside)  # so that there is an index at every moment
        except OSError:  # a file system without links
            os.rename(place, aside)
    os.replace(new, place)
    return aside


def _remove(path: Path) -> None:
    for part in (*SQLITE_PARTS, ".lock"):
        Path(f"{path}{part}").unlink(missing_ok=True)
