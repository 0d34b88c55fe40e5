"""The function that opens an index for a service, before the tool moves."""

import os
from pathlib import Path

from sqlalchemy import URL

from app.index.database import explain_database_errors
from app.index.rebuild import (
    BEHIND_MARKER_FILE,
    RebuildResult,
    RecordingReader,
    find_recordings,
    ingest_recording,
    parse_journal_lines,
)
from app.index.store import Store

MAX_BATCH_LINES = 500
MAX_CATCH_UP_RECORDINGS = 3  # recordings that a killed service may have left; more would delay the start
MAX_CATCH_UP_BYTES = 4_000_000  # of the journal's end; about 10,000 lines


def open_store_for_service(url: URL, data: Path, readers: tuple[RecordingReader, ...]) -> Store:
    """Return the open store with the journal's last lines and the few recordings that it lacked.

    If it lacks many recordings, it is marked as behind.

    Raises:
        ConfigurationError: PostgreSQL's driver is missing.
        ServiceError: it cannot be opened or written; the text says why and what to do next.
    """
    store = Store(url)
    try:
        ingest_journal_tail(store, data / "journal.jsonl")
        if store.had_no_other_user:  # otherwise another service may be writing them
            _ingest_missing_recordings(store, data, readers)
    except BaseException:
        store.close()
        raise
    return store


def ingest_journal_tail(store: Store, journal: Path) -> None:
    """Ingest the last journal lines that the index lacks, because it could not be written at their time."""
    try:
        with journal.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(size - MAX_CATCH_UP_BYTES, 0))
            if size > MAX_CATCH_UP_BYTES:
                file.readline()  # the rest of a line
            entries = [entry for entry in parse_journal_lines(file) if entry]
    except OSError:
        return  # no journal yet; the journal's writer reports one that cannot be read
    with explain_database_errors(store.url):
        for begin in range(0, len(entries), MAX_BATCH_LINES):
            store.ingest_new_lines(entries[begin : begin + MAX_BATCH_LINES])


def _ingest_missing_recordings(store: Store, data: Path, readers: tuple[RecordingReader, ...]) -> None:
    known = store.list_file_names()
    missing = {path: reader for path, reader in find_recordings(data, readers).items() if path.name not in known}
    if len(missing) > MAX_CATCH_UP_RECORDINGS:
        (data / BEHIND_MARKER_FILE).touch()
        return
    with explain_database_errors(store.url):
        for path, reader in missing.items():
            _ingest_one(store, path, reader)


def ingest_if_missing(store: Store, path: Path, readers: tuple[RecordingReader, ...]) -> None:
    """Ingest a recording of the data folder that the index lacks, such as an imported one.

    Raises:
        ServiceError: the index cannot be written.
    """
    reader = next((each for each in readers if path.name.endswith(each.suffix)), None)
    with explain_database_errors(store.url):
        if reader and store.get_file(path.name) is None:
            _ingest_one(store, path, reader)


def _ingest_one(store: Store, path: Path, reader: RecordingReader) -> None:
    with store.write_transaction() as session:
        ingest_recording(session, path, reader, RebuildResult())  # the list of recordings shows its problems
