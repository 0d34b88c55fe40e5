"""The index as a service keeps it: it waits for a database at fault, and never holds the event loop up."""

import asyncio
import resource
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from messages import alarm, line, run
from sqlalchemy import URL, text

from app.index import index_writer
from app.index.database import make_engine, resolve_index_url
from app.index.index_writer import IndexWriter
from app.index.queries import AlarmQuery, AuditQuery
from app.index.rebuild import BEHIND_MARKER_FILE, rebuild
from app.index.status import read_status
from app.index.store import Store


def keep(
    url: URL, use: Callable[[IndexWriter, list[str | None]], Awaitable[None]], marker: Path = Path("/nowhere/marker")
) -> IndexWriter:
    async def used() -> IndexWriter:
        told: list[str | None] = []
        index = IndexWriter(Store(url), marker, told.append)
        index.start()
        try:
            await use(index, told)
        finally:
            await index.aclose()
        return index

    return asyncio.run(used())


def lines_in(url: URL) -> int:
    store = Store(url)
    try:
        return store.find_audit_entries(AuditQuery()).total
    finally:
        store.close()


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(10):
        while not condition():
            await asyncio.sleep(0.02)


def test_what_is_asked_includes_what_has_just_happened(url: URL) -> None:
    async def use(index: IndexWriter, told: list[str | None]) -> None:
        for number in range(300):
            index.enqueue(line(number))
        index.enqueue(run())
        assert await index.query(index.store.get_run, "run-001") == run()
        assert (await index.query(index.store.find_audit_entries, AuditQuery())).total == 300
        assert told == []

    keep(url, use)


def test_what_waits_is_written_when_it_is_closed(url: URL) -> None:
    async def use(index: IndexWriter, told: list[str | None]) -> None:
        for number in range(2000):
            index.enqueue(line(number))

    keep(url, use)
    assert lines_in(url) == 2000


def break_it(url: URL, *, broken: bool) -> None:
    """Take the table away that lines are written to, or put it back."""
    engine = make_engine(url)
    names = ("audit", "away") if broken else ("away", "audit")
    with engine.execution_options(writes=True).begin() as connection:
        connection.execute(text("ALTER TABLE {} RENAME TO {}".format(*names)))
    engine.dispose()


def test_a_fault_is_told_once_and_nothing_is_lost(url: URL, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index_writer, "RETRY_DELAY_S", 0.05)

    async def use(index: IndexWriter, told: list[str | None]) -> None:
        index.enqueue(line(1))
        await index.wait_until_written()
        break_it(url, broken=True)
        for number in range(2, 50):
            index.enqueue(line(number))
            await asyncio.sleep(0.005)
        await until(lambda: told)
        assert not await index.wait_until_written()
        break_it(url, broken=False)
        await until(lambda: told[-1] is None)
        assert len(told) == 2
        assert "cannot be written" in str(told[0])
        assert "secret" not in str(told[0])
        await index.wait_until_written()

    assert keep(url, use).dropped_messages == 0
    assert lines_in(url) == 49


def test_a_full_disk_is_told_and_ends_when_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index_writer, "RETRY_DELAY_S", 0.05)
    url = resolve_index_url(None, tmp_path)

    async def use(index: IndexWriter, told: list[str | None]) -> None:
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
        try:
            index.enqueue(line(1, "x" * 20_000))
            await until(lambda: told)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert "make room" in str(told[0])
        await until(lambda: told[-1] is None)

    assert keep(url, use).dropped_messages == 0
    assert lines_in(url) == 1


def test_what_there_is_no_room_for_is_counted_and_told_until_a_rebuild(
    url: URL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(index_writer, "RETRY_DELAY_S", 0.05)
    monkeypatch.setattr(index_writer, "MAX_QUEUED_MESSAGES", 10)
    monkeypatch.setattr(index_writer, "MAX_BATCH_MESSAGES", 1)

    async def use(index: IndexWriter, told: list[str | None]) -> None:
        break_it(url, broken=True)
        begin_s = time.monotonic()
        for number in range(100):
            index.enqueue(line(number))
        assert time.monotonic() - begin_s < 1.0
        await until(lambda: told)
        break_it(url, broken=False)
        await until(lambda: told[-1] and "graspwatch index --rebuild" in told[-1])
        await until(lambda: not index._queue.qsize())  # noqa: SLF001 - nothing else says that it has read all

    index = keep(url, use, tmp_path / BEHIND_MARKER_FILE)
    assert index.dropped_messages + lines_in(url) == 100
    assert index.dropped_messages >= 80

    async def use_again(index: IndexWriter, told: list[str | None]) -> None:
        index.enqueue(line(200))
        await until(lambda: told)
        assert await index.wait_until_written()

    keep(url, use_again, tmp_path / BEHIND_MARKER_FILE)
    assert "could not be written" in read_status(url, tmp_path, ()).behind[0]
    rebuild(url, tmp_path, (), lambda _: None)
    assert read_status(url, tmp_path, ()).behind == []


def test_a_message_that_no_table_takes_is_left_out_alone(url: URL) -> None:
    async def use(index: IndexWriter, told: list[str | None]) -> None:
        index.enqueue(line(1))
        index.enqueue(run(started_at="yesterday"))
        index.enqueue(line(2))
        await until(lambda: told)
        assert "graspwatch index --rebuild" in str(told[0])

    assert keep(url, use).dropped_messages == 1
    assert lines_in(url) == 2


def test_a_database_at_fault_does_not_hold_up_the_end(url: URL, tmp_path: Path) -> None:
    async def use(index: IndexWriter, told: list[str | None]) -> None:
        break_it(url, broken=True)
        index.enqueue(line(1))
        await until(lambda: told)

    begin_s = time.monotonic()
    index = keep(url, use)
    assert time.monotonic() - begin_s < 5.0
    assert index.dropped_messages == 1


def test_an_alarm_that_changes_all_the_time_is_there_as_it_was_last(url: URL) -> None:
    async def use(index: IndexWriter, told: list[str | None]) -> None:
        for change in range(1, 500):
            index.enqueue(alarm(change, id=f"force-{change % 2}"))
        found = await index.query(index.store.find_alarms, AlarmQuery(order="oldest"))
        assert [each.change for each in found.items] == [498, 499]

    keep(url, use)


def test_a_bug_in_the_writer_is_told(url: URL, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threading, "excepthook", lambda _: None)

    async def use(index: IndexWriter, told: list[str | None]) -> None:
        monkeypatch.setattr(index.store, "ingest_all", lambda _: 1 / 0)
        index.enqueue(line(1))
        await until(lambda: told)
        assert "failed inside" in str(told[0])
        assert not await index.wait_until_written()

    keep(url, use)
