"""The index takes messages and answers questions, the same on SQLite and on a real PostgreSQL server."""

import multiprocessing
import random
from collections.abc import Callable
from datetime import timedelta

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from messages import BEGIN, alarm, grasp, line, mark, record, run, truth
from sqlalchemy import URL, delete

from app.index.ingest import IndexedMessage
from app.index.queries import AlarmQuery, AuditQuery, FileQuery, GraspQuery, RunQuery, SortOrder
from app.index.store import Store
from app.index.tables import IndexTable
from app.messages.journal import JournalKind
from app.messages.runs import RunState
from estimator.force_alarms import Priority

FINISHED = RunState.FINISHED


def test_a_run_is_there_from_its_start_and_over_when_it_is_over(store: Store) -> None:
    store.ingest(run())
    assert store.get_run("run-001") == run()
    assert store.find_unfinished_runs() == [run()]
    store.ingest(grasp(index=1))
    store.ingest(grasp(index=2))
    over = run(state=FINISHED, grasps=1)
    store.ingest(over)
    store.ingest(run())  # a message that comes late
    assert store.get_run("run-001") == over.model_copy(update={"grasps": 2})
    assert store.find_unfinished_runs() == []
    assert [each.index for each in store.list_run_grasps("run-001")] == [1, 2]


def test_a_run_that_only_its_grasps_are_known_of_is_not_made_up(store: Store) -> None:
    store.ingest(grasp(7))
    assert store.get_run("run-007") is None
    assert store.find_runs(RunQuery()).total == 0
    assert store.find_grasps(GraspQuery(run="run-007")).items == [grasp(7)]


def test_a_grasp_without_a_run_gets_that_of_its_recording_or_is_left_out(store: Store) -> None:
    stray = grasp().model_copy(update={"run_id": None})
    store.ingest(stray)
    assert store.find_grasps(GraspQuery()).total == 0
    store.ingest(stray, run_id="run-001")
    assert store.find_grasps(GraspQuery()).items == [grasp()]


def test_a_line_of_the_journal_brings_what_it_is_about(store: Store) -> None:
    gone = record(deleted_at=BEGIN.isoformat(), deleted_by="Ada")
    for entry in (
        line(1, "Run started", kind=JournalKind.RUN, run=run()),
        line(2, "Low alarm", kind=JournalKind.ALARM, alarm=alarm()),
        line(3, "Recording deleted", kind=JournalKind.DELETED, by="Ada", file=gone),
    ):
        store.ingest(entry)
    assert store.get_run("run-001") == run()
    assert store.find_alarms(AlarmQuery()).items == [alarm()]
    assert store.get_file("run-001.rec") == gone
    store.ingest(record())  # it was put back
    store.ingest(line(3, "Recording deleted", kind=JournalKind.DELETED, by="Ada", file=gone))  # an old line again
    assert store.get_file("run-001.rec") == record()


def test_the_newest_statement_and_the_newest_mark_count(store: Store) -> None:
    store.ingest(line(3, "corrected", kind=JournalKind.TRUTH, truth=truth(2, 2, held="bladder", why="the video")))
    store.ingest(line(2, "stated", kind=JournalKind.TRUTH, truth=truth(2, 1)))
    store.ingest(truth(1, 1))
    run_id = run().id
    assert [(each.grasp, each.held) for each in store.list_run_truths(run_id)] == [(1, "liver"), (2, "bladder")]
    assert store.list_run_truths("none") == []

    store.ingest(line(1, "mark", kind=JournalKind.MARK, mark=mark()))
    assert [each.text for each in store.list_run_marks(run_id)] == ["smoke"]
    store.ingest(line(2, "deleted", kind=JournalKind.MARK, mark=mark(2, deleted=True)))
    assert store.list_run_marks(run_id) == []
    assert store.get_mark(mark().id) == mark(2, deleted=True)


def test_words_that_a_database_does_not_like_are_kept(store: Store) -> None:
    odd = run(by="A\0da 100 %_ \N{GRINNING FACE}", state=FINISHED)
    store.ingest(odd)
    assert store.get_run("run-001") == odd
    assert store.get_run("run\0") is None
    assert store.find_runs(RunQuery(q="100 %_")).total == 1
    assert store.find_runs(RunQuery(q="_00")).total == 0  # no wildcard


def fill(store: Store) -> None:
    for number in range(1, 8):
        tissue = "liver" if number % 2 else "bladder"
        store.ingest(
            run(number, tissue=tissue, by=f"P{number % 3}", state=FINISHED if number < 7 else RunState.RUNNING)
        )
        store.ingest(grasp(number, label=tissue if number != 3 else "unknown", valid=number != 5))
        store.ingest(line(60.0 * number, f"Run {number}", kind=JournalKind.RUN, by=f"P{number % 3}"))
        store.ingest(record(number))
    store.ingest(alarm(ended_ms=BEGIN.timestamp() * 1e3 + 95_000, active=False))
    store.ingest(
        alarm(id="disk-1", kind="technical", priority=Priority.MEDIUM, began_ms=BEGIN.timestamp() * 1e3 + 300_000)
    )
    store.ingest(record(2, deleted_at=BEGIN.isoformat(), deleted_by="Ada"))


def numbers(store: Store, **asked: object) -> list[int]:
    return [int(each.id[-3:]) for each in store.find_runs(RunQuery(**asked)).items]


def test_runs_are_found(store: Store) -> None:
    fill(store)
    assert numbers(store) == [1, 2, 3, 4, 5, 6, 7]
    assert numbers(store, order=SortOrder.NEWEST, limit=2, offset=1) == [6, 5]
    assert store.find_runs(RunQuery(limit=2)).total == 7
    assert numbers(store, state="running") == [7]
    assert numbers(store, tissue="bladder", by="P1") == [4]
    assert numbers(store, label="unknown") == [3]
    assert numbers(store, q="RUN-005") == [5]
    assert numbers(store, protocol="nope") == []
    third = BEGIN + timedelta(seconds=180)
    assert numbers(store, since=third, until=third + timedelta(seconds=60)) == [3]


def test_grasps_alarms_lines_and_files_are_found(store: Store) -> None:
    fill(store)
    assert [each.run_id for each in store.find_grasps(GraspQuery(valid=False)).items] == ["run-005"]
    assert store.find_grasps(GraspQuery(label="liver", tissue="liver", limit=1)).total == 3
    assert [each.id for each in store.find_alarms(AlarmQuery()).items] == ["disk-1", "force-1"]
    assert [each.id for each in store.find_alarms(AlarmQuery(run="run-001")).items] == ["force-1"]
    assert [each.id for each in store.find_alarms(AlarmQuery(run="run-006")).items] == ["disk-1"]
    assert store.find_alarms(AlarmQuery(kind="technical", priority="medium", q="FORCE")).total == 1
    assert [each.text for each in store.find_audit_entries(AuditQuery(by="P1", order=SortOrder.OLDEST)).items] == [
        "Run 1",
        "Run 4",
        "Run 7",
    ]
    assert store.find_audit_entries(AuditQuery(kind="alarm")).total == 0
    assert [each.name for each in store.find_files(FileQuery(deleted=True)).items] == ["run-002.rec"]
    assert store.find_files(FileQuery(deleted=False, q=".REC")).total == 6


def random_messages(seed: int, count: int) -> list[IndexedMessage]:
    """Of a few things, so that they meet; without files, where the order counts."""
    chance = random.Random(seed)
    makers: list[Callable[[], IndexedMessage]] = [
        lambda: run(chance.randrange(3), state=chance.choice(list(RunState)), grasps=chance.randrange(4)),
        lambda: grasp(chance.randrange(3), chance.randrange(1, 4), end_s=chance.random(), label=chance.choice("ab")),
        lambda: alarm(chance.randrange(1, 9), id=f"force-{chance.randrange(3)}", active=chance.random() < 0.5),
        lambda: line(chance.randrange(5), chance.choice("ab"), run=run(chance.randrange(3), state=FINISHED)),
        lambda: line(chance.randrange(5), alarm=alarm(chance.randrange(1, 9), id="force-1")),
        lambda: truth(chance.randrange(1, 4), chance.randrange(1, 4), held=chance.choice(["liver", None])),
        lambda: line(chance.randrange(5), mark=mark(chance.randrange(1, 4), deleted=chance.random() < 0.5)),
    ]
    return [chance.choice(makers)() for _ in range(count)]


@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), count=st.integers(0, 30))
def test_any_messages_taken_twice_or_in_another_order_give_the_same_index(store: Store, seed: int, count: int) -> None:
    messages = random_messages(seed, count)
    shuffled = random.Random(seed).sample(messages, count)
    contents = []
    for several in (messages, [*messages, *messages], shuffled, [*shuffled, *reversed(messages)]):
        with store.write_transaction() as session:
            for table in reversed(IndexTable.metadata.sorted_tables):
                session.execute(delete(table))
        store.ingest_all((message, None) for message in several)
        contents.append(store.dump())
    assert all(content == contents[0] for content in contents)


def write_many(url: URL, writer: int) -> None:
    store = Store(url)
    for number in range(40):
        store.ingest(line(number, f"writer {writer}"))
        store.ingest(run(number % 5, grasps=number))  # the same rows as the other writer
        store.ingest(grasp(number % 5, number + 1))
    store.close()


def test_two_processes_write_at_the_same_time(url: URL) -> None:
    """They also meet in making the tables."""
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=write_many, args=(url, writer)) for writer in range(2)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(60)
    assert [writer.exitcode for writer in writers] == [0, 0]
    store = Store(url)
    assert store.find_audit_entries(AuditQuery()).total == 80
    assert store.find_grasps(GraspQuery()).total == 40
    assert max(each.grasps for each in store.find_runs(RunQuery()).items) == 40
    store.close()


def test_one_batch_is_written_as_a_whole_or_not_at_all(store: Store) -> None:
    with pytest.raises(ValueError, match="isoformat"):
        store.ingest_all([(run(1), None), (run(2, started_at="yesterday"), None)])
    assert store.get_run("run-001") is None
