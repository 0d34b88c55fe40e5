"""The index from the files is the one that was kept live, and a rebuild puts it in the old one's place as a whole."""

import gzip
import random
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from messages import BEGIN, alarm, grasp, line, record, run
from recorded import READERS, write_recording
from sqlalchemy import URL

from app.index import rebuild as rebuilding
from app.index.database import resolve_index_url
from app.index.ingest import IndexedMessage
from app.index.queries import AuditQuery
from app.index.rebuild import rebuild
from app.index.status import read_status
from app.index.store import Store
from app.messages.journal import JournalEntry
from config.errors import ServiceError


def nothing(share: float) -> None:
    """Nobody watches."""


def live(store: Store, data: Path, seed: int, runs: int) -> None:
    """Some runs as a service has them: to the index at once, to the journal, to a recording each; one is deleted."""
    chance = random.Random(seed)
    journal: list[JournalEntry] = []

    def tell(message: IndexedMessage, recording: list[IndexedMessage]) -> None:
        store.ingest(message)
        recording.append(message)
        if isinstance(message, JournalEntry):
            journal.append(message)

    for number in range(1, runs + 1):
        messages: list[IndexedMessage] = []
        tell(run(number), messages)
        tell(line(60.0 * number, "Run started", kind="run", run=run(number)), messages)
        grasps = chance.randrange(4)
        for index in range(1, grasps + 1):
            tell(grasp(number, index, label=chance.choice(["liver", "unknown"])), messages)
            tell(alarm(index, id=f"force-{number}", active=index < 3), messages)
        if number == runs or chance.random() < 0.8:  # else the service was killed
            over = run(number, state=chance.choice(["finished", "stopped", "failed"]), grasps=grasps)
            tell(line(60.0 * number + 30, "Run over", kind="run", run=over), messages)
            tell(over, messages)
        write_recording(data, record(number), messages)
        store.ingest(record(number))
        tell(line(60.0 * number + 40, "Idle", alarm=alarm(9, id=f"force-{number}", active=False)), [])
    gone = record(runs, deleted_at=BEGIN.isoformat(), deleted_by="Ada")
    tell(line(60.0 * number + 50, "Recording deleted", kind="deleted", by="Ada", file=gone), [])
    (data / "recordings" / gone.name).unlink()
    (data / "journal.jsonl").write_text("".join(f"{entry.to_line()}\n" for entry in journal))


@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), runs=st.integers(2, 5))
def test_the_index_from_the_files_equals_the_live_one(
    new_url: Callable[[], URL], tmp_path_factory: pytest.TempPathFactory, seed: int, runs: int
) -> None:
    """But for the grasps of a recording that was deleted: the journal only knows how many its run had."""
    data, one, other = tmp_path_factory.mktemp("data"), Store(new_url()), new_url()
    live(one, data, seed, runs)
    rebuilt = rebuild(other, data, READERS, nothing)
    assert (rebuilt.recordings, rebuilt.broken_lines, rebuilt.problems) == (runs - 1, 0, [])
    two = Store(other)
    kept, anew = one.dump(), two.dump()
    kept["grasps"] = [row for row in kept["grasps"] if row["run_id"] != f"run-{runs:03d}"]
    assert anew == kept
    for store in (one, two):
        store.close()


def test_what_cannot_be_read_is_told_and_the_rest_is_taken(url: URL, tmp_path: Path) -> None:
    good = write_recording(tmp_path, record(1), [run(1), grasp(1)])
    torn = write_recording(tmp_path, record(2), [run(2), grasp(2, 1)])
    torn.write_text(torn.read_text() + '["Graspe')
    (good.parent / "run-003.rec").write_text("rubbish\n")
    (good.parent / "notes.txt").write_text("no recording\n")
    (tmp_path / "journal.jsonl").write_text(f"{line(3).to_line()}\n\nrubbish\n{line(4).to_line()[:50]}")
    (tmp_path / "journal.jsonl.1").write_text(f"{line(2).to_line()}\n")
    (tmp_path / "journal.jsonl.2.gz").write_bytes(gzip.compress(f"{line(1).to_line()}\n".encode()))
    shares: list[float] = []
    rebuilt = rebuild(url, tmp_path, READERS, shares.append)
    assert (rebuilt.recordings, rebuilt.lines, rebuilt.broken_lines) == (3, 5, 2)
    assert rebuilt.problems[0] == "run-002.rec, line 4: is no message"
    assert all("run-003.rec" in problem for problem in rebuilt.problems[1:])
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    store = Store(url)
    assert store.find_audit_entries(AuditQuery()).total == 3
    assert [store.get_run(f"run-00{number}") is not None for number in (1, 2, 3)] == [True, True, False]
    assert store.get_file("run-002.rec") == record(2)
    store.close()


def test_a_rebuild_is_refused_while_a_service_runs(url: URL, tmp_path: Path) -> None:
    store = Store(url)
    store.ingest(run())
    with pytest.raises(ServiceError, match="Stop the service, then rebuild it"):
        rebuild(url, tmp_path, READERS, nothing)
    assert store.get_run("run-001") == run()
    store.close()


@pytest.mark.parametrize("fault", ["disk", "program"])
def test_a_rebuild_that_fails_leaves_the_old_index_as_it_was(
    url: URL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    store = Store(url)
    store.ingest(run(9))
    store.close()
    write_recording(tmp_path, record(1), [run(1)])

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device", "index") if fault == "disk" else RuntimeError("a bug")

    monkeypatch.setattr(rebuilding, "find_recordings", fail)
    with pytest.raises(ServiceError if fault == "disk" else RuntimeError, match=r"No space left|a bug"):
        rebuild(url, tmp_path, READERS, nothing)
    store = Store(url)
    assert store.get_run("run-009") == run(9)
    store.close()
    assert not list(tmp_path.glob("*.new*"))


@pytest.mark.parametrize("old", ["sound", "damaged", "newer"])
def test_the_old_file_is_set_aside_whatever_it_is(tmp_path: Path, old: str) -> None:
    url, place = resolve_index_url(None, tmp_path), tmp_path / "index.sqlite"
    write_recording(tmp_path, record(1), [run(1)])
    if old == "damaged":
        place.write_bytes(b"rubbish" * 1000)
    else:
        store = Store(url)
        store.ingest(run(9))
        store.close()
    if old == "newer":
        with sqlite3.connect(place) as connection:
            connection.execute("UPDATE graspwatch_revision SET version_num = '9999'")
        connection.close()
    before = place.read_bytes()
    rebuilt = rebuild(url, tmp_path, READERS, nothing)
    assert rebuilt.backup_path is not None
    assert rebuilt.backup_path.name.startswith("index.sqlite.2")
    assert rebuilt.backup_path.name.endswith(".bad")
    assert rebuilt.backup_path.read_bytes() == before
    store = Store(url)
    assert (store.get_run("run-001"), store.get_run("run-009")) == (run(1), None)
    store.close()


def test_the_status_says_what_the_index_lacks_and_changes_nothing(url: URL, tmp_path: Path) -> None:
    assert read_status(url, tmp_path, READERS).behind
    assert not (tmp_path / "index.sqlite").exists()
    write_recording(tmp_path, record(1), [run(1)])
    (tmp_path / "journal.jsonl").write_text(f"{line(1).to_line()}\n")
    rebuild(url, tmp_path, READERS, nothing)
    found = read_status(url, tmp_path, READERS)
    assert (found.behind, found.revision) == ([], found.newest_revision)
    assert found.counts == {
        "runs": 1,
        "grasps": 0,
        "truths": 0,
        "marks": 0,
        "lab_sessions": 0,
        "alarms": 0,
        "audit": 1,
        "files": 1,
    }
    assert "secret" not in found.where
    write_recording(tmp_path, record(2), [run(2)])
    with (tmp_path / "journal.jsonl").open("a") as file:
        file.write(f"{line(2).to_line()}\n")
    assert read_status(url, tmp_path, READERS).behind == [
        "1 of the recordings, such as run-002.rec",
        "the journal's last line",
    ]
