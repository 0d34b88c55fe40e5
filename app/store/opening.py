"""Open an index for a service, before anything moves."""

import os
from pathlib import Path

from sqlalchemy import URL

from app.store.database import faults_explained
from app.store.rebuild import BEHIND_MARKER, READERS, Reader, Rebuilt, read_lines, recordings_in, take_recording
from app.store.store import Store

AT_ONCE = 500
CAUGHT_UP_RECORDINGS = 3  # what a killed service may have left; more would make the start slow
CAUGHT_UP_BYTES = 4_000_000  # of the journal's end; about 10,000 lines


def open_for_service(url: URL, data: Path, readers: tuple[Reader, ...] = READERS) -> Store:
    """Up to date, claimed, and with the last lines of the journal and the few recordings that it lacks.

    Where it lacks many, it is marked as behind.

    Raises:
        ConfigurationError: PostgreSQL's driver is missing.
        ServiceError: it cannot be opened or written; the text says why and what to do next.
    """
    store = Store(url)
    try:
        _take_lines(store, data / "journal.jsonl")
        if store.first:  # else they may be of another service, and under way
            _take_recordings(store, data, readers)
    except BaseException:
        store.close()
        raise
    return store


def _take_lines(store: Store, journal: Path) -> None:
    """Take those of the journal's last lines that the index lacks, because it could not be written when they were."""
    try:
        with journal.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(size - CAUGHT_UP_BYTES, 0))
            if size > CAUGHT_UP_BYTES:
                file.readline()  # the rest of a line
            entries = [entry for entry in read_lines(file) if entry]
    except OSError:
        return  # none yet; one that cannot be read is told by who writes it
    with faults_explained(store.url):
        for begin in range(0, len(entries), AT_ONCE):
            store.take_new_lines(entries[begin : begin + AT_ONCE])


def _take_recordings(store: Store, data: Path, readers: tuple[Reader, ...]) -> None:
    known = store.file_names()
    missing = {path: reader for path, reader in recordings_in(data, readers).items() if path.name not in known}
    if len(missing) > CAUGHT_UP_RECORDINGS:
        (data / BEHIND_MARKER).touch()
        return
    with faults_explained(store.url):
        for path, reader in missing.items():
            with store.writing() as session:
                take_recording(session, path, reader, Rebuilt())  # its faults are told with the list of recordings
