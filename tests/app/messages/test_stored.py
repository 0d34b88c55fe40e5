"""What an earlier version stored stays readable, and what a later version adds does no harm."""

import json
import shutil
import sqlite3
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from messages import alarm, grasp, line, mark, record, run, truth
from sqlalchemy import URL

from acquisition.recordings.mcap_reader import JsonMessage, McapFile
from app.audit.chain_check import check_journal
from app.audit.journal_export import JournalFilter, JournalFormat, export_lines
from app.index.ingest import line_key
from app.index.queries import AlarmQuery, AuditQuery, FileQuery, GraspQuery, RunQuery
from app.index.rebuild import parse_journal_lines, rebuild
from app.index.store import Store
from app.messages.alarms import Alarm
from app.messages.base import Record
from app.messages.grasps import Identification
from app.messages.journal import RECORD_FIELDS, JournalEntry, JournalKind
from app.messages.recordings import FileCondition
from app.messages.runs import Run, RunState
from app.messages.stored import read_stored
from app.messages.studies import StudyRun
from app.recordings.catalog import open_recording
from app.recordings.index_reader import RECORDING_READERS, read_file_record, read_recorded_messages
from app.recordings.run_reader import read_run
from app.recordings.topics import IDENTIFICATION_TOPIC, MARK_TOPIC, TOPIC_MODELS, decode_message, encode_message
from config.load import load_tool
from estimator.estimate_block import SpotVerdict

BEFORE = Path(__file__).parents[2] / "stored_before"
RECORDING = BEFORE / "20261130-030315-68cf-001.mcap"
RUN_ID = RECORDING.stem
ENTRIES = [entry for entry in parse_journal_lines((BEFORE / "journal.jsonl").read_bytes().splitlines()) if entry]


def open_index_before(folder: Path) -> Store:
    path = folder / "index.sqlite"
    with closing(sqlite3.connect(path)) as database:
        database.executescript((BEFORE / "index.sql").read_text())
    return Store(URL.create("sqlite", database=str(path)))


def everything_in(store: Store) -> dict[str, list[Any]]:
    found = {
        "runs": store.find_runs(RunQuery(limit=500)),
        "grasps": store.find_grasps(GraspQuery(limit=500)),
        "alarms": store.find_alarms(AlarmQuery(limit=500)),
        "lines": store.find_audit_entries(AuditQuery(limit=500)),
        "files": store.find_files(FileQuery(limit=500)),
    }
    return {name: page.items for name, page in found.items()}


def test_a_recording_of_the_version_before_is_read_in_full() -> None:
    recorded = read_run(RECORDING)
    assert recorded.run is not None
    assert (recorded.run.id, recorded.run.state, recorded.run.by) == (RUN_ID, RunState.FINISHED, "Ada")
    assert [(each.label, each.held_back, len(each.alarms)) for each in recorded.grasps] == [("bladder", True, 1)]
    assert len(recorded.samples) == len(recorded.estimates) == 300
    kinds = Counter(type(message).__name__ for _, message in read_recorded_messages(RECORDING))
    assert kinds == {"Run": 2, "GraspEnded": 1, "Alarm": 5, "JournalEntry": 6}
    assert read_file_record(RECORDING).condition is FileCondition.COMPLETE
    with open_recording(RECORDING, load_tool("simulated")) as source:
        block = source.read_block()
        assert block is not None
        assert len(block) > 0


def test_an_index_of_the_version_before_is_read_in_full_and_knows_the_lines_of_its_journal(tmp_path: Path) -> None:
    with closing(open_index_before(tmp_path)) as store:
        found = everything_in(store)
        assert {name: len(items) for name, items in found.items()} == {
            "runs": 1,
            "grasps": 1,
            "alarms": 2,
            "lines": len(ENTRIES),
            "files": 1,
        }
        assert found["grasps"][0].grasp == read_run(RECORDING).grasps[0]
        assert {line_key(entry) for entry in found["lines"]} == {line_key(entry) for entry in ENTRIES}
        store.ingest_new_lines(ENTRIES)
        assert everything_in(store) == found


def test_a_rebuild_from_files_of_the_version_before_finds_what_its_index_held(tmp_path: Path) -> None:
    data = tmp_path / "data"
    (data / "recordings").mkdir(parents=True)
    shutil.copy(RECORDING, data / "recordings")
    shutil.copy(BEFORE / "journal.jsonl", data)
    url = URL.create("sqlite", database=str(tmp_path / "new.sqlite"))
    result = rebuild(url, data, RECORDING_READERS, lambda share: None)
    assert (result.problems, result.broken_lines, result.recordings) == ([], 0, 1)
    with closing(open_index_before(tmp_path)) as before, closing(Store(url)) as rebuilt:
        then, now = everything_in(before), everything_in(rebuilt)
    for part in ("runs", "grasps", "alarms", "lines"):
        assert now[part] == then[part]


def with_unknown_fields(content: Any) -> Any:
    """The content as a later version may write it: with a further field in each object of a record."""
    if not isinstance(content, dict):
        return content
    inner = {
        name: with_unknown_fields(each) if name in (*RECORD_FIELDS, "grasp") else each for name, each in content.items()
    }
    return {"of_a_later_version": {"x": [1, None]}, **inner}


STORED_RECORDS: list[Record] = [
    run(),
    grasp(),
    alarm(),
    record(),
    line(run=run(), alarm=alarm(), file=record()),
    truth(),
    mark(),
    line(truth=truth(), mark=mark()),
    StudyRun(
        id="1",
        study="identify",
        title="",
        grasps=1,
        seed=0,
        by=None,
        state="finished",
        done=1,
        of=1,
        started_at="2026-11-30",
        ended_at=None,
        why=None,
        report=None,
    ),
]


@pytest.mark.parametrize("stored", STORED_RECORDS, ids=lambda each: type(each).__name__)
def test_a_record_of_a_later_version_is_read_without_the_fields_that_are_not_known(stored: Record) -> None:
    content = with_unknown_fields(json.loads(stored.model_dump_json()))
    assert read_stored(type(stored), content) == stored
    assert read_stored(type(stored), json.dumps(content).encode()) == stored


def test_records_in_a_list_may_lack_fields_without_a_value() -> None:
    """A recording leaves out what is null, also in the spots of an identification."""
    spot = SpotVerdict(index=1, grasps=(1,), label="undecided", probability=None, probabilities={}, began_s=0.0)
    told = Identification(
        server_time_ms=0.0,
        tick=5,
        grasp=0,
        in_grasp=False,
        in_contact=False,
        label="undecided",
        probability=None,
        probabilities={},
        time_to_decision_s=None,
        force_n=None,
        peak_force_n=None,
        threshold_n=1.0,
        threshold_tissue=None,
        limit_n=None,
        holding_back=False,
        time_to_limit_s=None,
        thickness_m=None,
        convergence_s={},
        force_error_n={},
        spots=(spot,),
    )
    assert decode_message(IDENTIFICATION_TOPIC, encode_message(told)) == told


def test_the_messages_of_a_recording_of_a_later_version_are_read() -> None:
    told = [each for each in McapFile(RECORDING).iter_content(*TOPIC_MODELS) if isinstance(each, JsonMessage)]
    assert {each.topic for each in told} == set(TOPIC_MODELS) - {MARK_TOPIC}  # that version had no marks
    for each in told:
        later = json.dumps(with_unknown_fields(json.loads(each.content))).encode()
        assert decode_message(each.topic, later) == decode_message(each.topic, each.content)


def test_a_journal_of_a_later_version_is_read_checked_and_exported(tmp_path: Path) -> None:
    later = tmp_path / "journal.jsonl"
    unchained = [{**json.loads(each), "hash": None} for each in (BEFORE / "journal.jsonl").read_text().splitlines()]
    later.write_text("".join(json.dumps(with_unknown_fields(each)) + "\n" for each in unchained))
    assert [entry.text for entry in parse_journal_lines(later.read_bytes().splitlines()) if entry] == [
        entry.text for entry in ENTRIES
    ]
    assert len([*export_lines(tmp_path, JournalFilter(), JournalFormat.CSV)]) == 1 + len(ENTRIES)
    shutil.copy(BEFORE / "journal.jsonl", later)
    assert check_journal(tmp_path, []).whole


class LaterRun(Run):
    """A run as a later version may define it: every client gets the new field, and an old file lacks it."""

    ward: str = "not stated"


class LaterAlarm(Alarm):
    sound: str = "beep"


class LaterEntry(JournalEntry):
    run: LaterRun | None = None
    alarm: LaterAlarm | None = None


def test_a_field_that_is_added_has_its_default_in_old_files_and_is_always_sent() -> None:
    recorded = [each for each in McapFile(RECORDING).iter_content("/run") if isinstance(each, JsonMessage)]
    found = read_stored(LaterRun, recorded[-1].content)
    assert found.ward == "not stated"
    assert found.model_dump(exclude={"ward"}) == read_stored(Run, recorded[-1].content).model_dump()
    assert json.loads(found.model_dump_json())["ward"] == "not stated"


def test_a_field_that_is_added_leaves_the_keys_of_old_journal_lines() -> None:
    about = [entry for entry in ENTRIES if entry.run or entry.alarm]
    assert {entry.kind for entry in about} >= {JournalKind.RUN, JournalKind.ALARM}
    for entry in about:
        later = read_stored(LaterEntry, entry.model_dump_json())
        assert line_key(later) == line_key(entry)
    changed = line(alarm=alarm(), text="on")
    silent = LaterEntry.model_validate(
        {**changed.model_dump(), "alarm": LaterAlarm(**alarm().model_dump(), sound="none")}
    )
    assert line_key(silent) != line_key(changed)
