"""Nothing of the journal can be changed, removed, put in or moved unseen; and it goes on whatever happened to it."""

import asyncio
import gzip
import multiprocessing
import os
import resource
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.audit.chain_check import ChainCheckpoint, check_journal
from app.audit.journal import Journal
from app.messages.journal import JournalCheck, JournalEntry, JournalKind, Result
from config.errors import JournalError

OLD = b'{"at":"2026-11-01T08:00:00+00:00","kind":"event","text":"The tool is acquiring"}\n'
OLDER = OLD.replace(b"11-01", b"10-31")


def ignore(_: object) -> None:
    """Nobody listens."""


def written(data: Path, lines: int = 3, told: Callable[[JournalEntry], object] = ignore) -> None:
    """Some lines of one service."""
    journal = Journal(data, ignore, told)
    for number in range(lines):
        assert journal.write(JournalKind.EVENT, f"Event {number} µ", by="Ada")
    assert asyncio.run(journal.wait_until_synced())


def lines_in(data: Path) -> list[bytes]:
    return (data / "journal.jsonl").read_bytes().splitlines(keepends=True)


def witnesses(entries: list[JournalEntry], who: str = "the index") -> list[ChainCheckpoint]:
    return [ChainCheckpoint(who, e.chain or "", e.number or 0, e.hash or "", e.text) for e in entries if e.hash]


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[JournalEntry], bytes]:
    """A journal with two lines of an older version, continued over a restart; what the index knows of it."""
    data, known = tmp_path_factory.mktemp("data"), []
    (data / "journal.jsonl").write_bytes(OLDER + OLD)
    for _ in range(2):
        written(data, 3, known.append)
    return data, known, (data / "journal.jsonl").read_bytes()


def found(sealed: tuple[Path, list[JournalEntry], bytes], content: bytes, index: bool = True) -> JournalCheck:
    data, known, _ = sealed
    (data / "journal.jsonl").write_bytes(content)
    return check_journal(data, witnesses(known) if index else [])


def test_a_journal_is_whole_over_restarts_and_says_where_its_chain_begins(sealed) -> None:
    _, known, content = sealed
    whole = found(sealed, content)
    assert (whole.whole, whole.problem, whole.lines, whole.unchained, whole.newest) == (True, None, 7, 2, 9)
    assert whole.newest_hash == known[-1].hash
    assert "2 lines of an older version" in whole.notes[0]
    assert (known[0].kind, known[0].text) == (
        JournalKind.CHAIN,
        "The chain of the journal begins, after 2 lines that are not in it",
    )


@given(chance=st.data())
def test_a_change_of_any_byte_is_found(sealed, chance: st.DataObject) -> None:
    """Without the index, a new last line looks as if the power had failed in it: that is told, too."""
    content = bytearray(sealed[2])
    place = chance.draw(st.integers(0, len(content) - 1))
    content[place] ^= chance.draw(st.integers(1, 255))
    assert found(sealed, bytes(content)).problem
    alone, before = found(sealed, bytes(content), index=False), found(sealed, sealed[2], index=False)
    assert alone.problem or alone.notes != before.notes


@given(chance=st.data())
def test_bytes_that_are_put_in_or_taken_out_are_found(sealed, chance: st.DataObject) -> None:
    content = sealed[2]
    begin = chance.draw(st.integers(0, len(content)))
    end = chance.draw(st.integers(begin, len(content)))
    other = content[:begin] + chance.draw(st.binary(max_size=300)) + content[end:]
    result = found(sealed, other)
    if other == content:
        assert result.whole
    else:
        assert result.problem or len(result.notes) > 1  # bytes after its end: a line that was being written


@given(chance=st.data())
def test_lines_that_were_removed_repeated_or_moved_are_found(sealed, chance: st.DataObject) -> None:
    lines = sealed[2].splitlines(keepends=True)
    numbers = st.lists(st.integers(0, len(lines) - 1), max_size=len(lines) + 2)
    order = chance.draw(st.permutations(range(len(lines))) | numbers)
    result = found(sealed, b"".join(lines[number] for number in order))
    assert result.whole == (list(order) == list(range(len(lines))))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda lines: [*lines[:4], lines[4].replace(b"Ada", b"Eve"), *lines[5:]], "line 5: it was changed"),
        (lambda lines: [*lines[:4], *lines[5:]], "line 5: lines are missing before it: number 5 is due"),
        (lambda lines: [*lines[:4], lines[5], lines[4], *lines[6:]], "line 5: lines are missing before it"),
        (lambda lines: [*lines[:5], lines[4], *lines[5:]], "line 6: it is in the wrong place: number 6 is due"),
        (lambda lines: [*lines[:5], OLD, *lines[5:]], "line 6: it was changed, or is no line of the journal"),
        (lambda lines: lines[3:], "line 1: the chain's beginning is missing"),
        (lambda lines: [lines[0], *lines[2:]], "line 2: the lines before the chain's beginning were changed"),
        (lambda lines: lines[:-2], "line number 8 is missing, which the index knows ('Event 1 µ')"),
        (lambda lines: [], "line number 3 is missing, which the index knows"),
    ],
)
def test_the_first_place_is_named(sealed, change: Callable[[list[bytes]], list[bytes]], says: str) -> None:
    lines = sealed[2].splitlines(keepends=True)
    assert says in (found(sealed, b"".join(change(lines))).problem or "")


def test_a_chain_that_was_written_anew_is_not_the_one_that_others_know(sealed, tmp_path: Path) -> None:
    """Whoever may write the file may seal other lines: the index knows better, and so does a recording."""
    known = sealed[1]
    written(tmp_path, 20)
    assert check_journal(tmp_path, []).whole
    assert "is not the one that the index knows" in (check_journal(tmp_path, witnesses(known)).problem or "")
    assert any("of another journal" in note for note in check_journal(tmp_path, [], witnesses(known, "a.mcap")).notes)
    mine: list[JournalEntry] = []
    written(tmp_path, 2, mine.append)
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b"".join(lines_in(tmp_path)[:-1]))
    assert "which the recording a.mcap knows" in (
        check_journal(tmp_path, [], witnesses(mine, "the recording a.mcap")).problem or ""
    )
    written(tmp_path, 3)
    assert "is not the one" in (check_journal(tmp_path, [], witnesses(mine, "a.mcap")).problem or "")


@pytest.mark.parametrize("kept", [1, 40, -1])
def test_a_line_that_was_cut_off_is_told_and_the_chain_goes_on(tmp_path: Path, kept: int) -> None:
    written(tmp_path)
    path = tmp_path / "journal.jsonl"
    *whole, last = lines_in(tmp_path)
    path.write_bytes(b"".join(whole) + last[:kept])
    before = check_journal(tmp_path, [])
    assert before.whole
    after: list[JournalEntry] = []
    written(tmp_path, 2, after.append)
    result = check_journal(tmp_path, [])
    assert result.whole
    if kept == -1:  # only its end of line is missing: nothing is lost
        assert (before.notes, result.notes, len(after)) == ([], [], 2)
        return
    assert "line 4: the last line was cut off" in before.notes[0]
    assert "line 5: the line before was cut off" in result.notes[0]
    assert after[0].text.startswith(f"A line of the journal was cut off here, after {kept} bytes")
    path.write_bytes(path.read_bytes().replace(last[:kept] + b"\n", last[: kept - 1] + b"?\n", 1))
    assert check_journal(tmp_path, []).problem


def test_a_damaged_last_line_does_not_look_mended_by_what_follows(tmp_path: Path) -> None:
    written(tmp_path)
    path = tmp_path / "journal.jsonl"
    path.write_bytes(path.read_bytes().replace(b"Event 2", b"Event 9"))
    after: list[JournalEntry] = []
    written(tmp_path, 1, after.append)
    assert "begins anew" in after[0].text
    assert "line 4: it was changed" in (check_journal(tmp_path, []).problem or "")


def test_a_journal_that_somebody_shortens_under_a_service_shows_the_gap(tmp_path: Path) -> None:
    journal = Journal(tmp_path, ignore, ignore)
    for number in range(4):
        journal.write(JournalKind.EVENT, f"Event {number}")
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b"".join(lines_in(tmp_path)[:-2]))
    journal.write(JournalKind.EVENT, "Later")
    assert "number 4 is due, and this is 6" in (check_journal(tmp_path, []).problem or "")


@pytest.mark.parametrize("compressed", [False, True])
def test_the_chain_goes_on_in_the_next_file(tmp_path: Path, compressed: bool) -> None:
    journal = Journal(tmp_path, ignore, ignore)
    for number in range(3):
        journal.write(JournalKind.EVENT, f"Event {number}")
    path, first, second = (tmp_path / f"journal.jsonl{ending}" for ending in ("", ".1", ".2"))
    path.rename(second)
    journal.write(JournalKind.EVENT, "After the first rotation")
    path.rename(first)
    if compressed:
        second.with_name("journal.jsonl.2.gz").write_bytes(gzip.compress(second.read_bytes()))
        second.unlink()
    os.utime(first, (0, 0))  # a copy may have lost its age
    written(tmp_path)
    assert check_journal(tmp_path, []).model_dump(include={"whole", "notes", "lines"}) == {
        "whole": True,
        "notes": [],
        "lines": 8,
    }
    first.unlink()
    assert "number 5 is due, and this is 6" in (check_journal(tmp_path, []).problem or "")


def write_many(data: Path, name: str) -> None:
    journal = Journal(data, ignore, ignore)
    for number in range(200):
        assert journal.write(JournalKind.EVENT, f"{name} {number}")


def test_programs_that_write_at_once_make_one_chain(tmp_path: Path) -> None:
    programs = [multiprocessing.Process(target=write_many, args=(tmp_path, name)) for name in ("one", "two", "three")]
    for program in programs:
        program.start()
    for program in programs:
        program.join(60)
        assert program.exitcode == 0
    assert check_journal(tmp_path, []).model_dump(include={"whole", "lines"}) == {"whole": True, "lines": 601}


def fill_a_disk(data: Path, faults: "multiprocessing.SimpleQueue[list]") -> None:
    """A file that may not grow any more is a disk that is full, with a part of the line on it."""
    told: list[object] = []
    heard: list[JournalEntry] = []
    journal = Journal(data, told.append, heard.append)
    journal.write(JournalKind.EVENT, "Before")
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    size = (data / "journal.jsonl").stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, resource.RLIM_INFINITY))
    sound = [journal.write(JournalKind.EVENT, f"Meanwhile {number}") for number in range(2)]
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    sound.append(journal.write(JournalKind.EVENT, "After"))
    newest = [(entry.text, entry.hash is not None) for entry in journal.newest_entries(3)]
    faults.put([sound, told, newest, [entry.text for entry in heard if entry.hash]])


def test_lines_wait_while_the_disk_is_full_and_none_is_lost(tmp_path: Path) -> None:
    faults: multiprocessing.SimpleQueue[list] = multiprocessing.SimpleQueue()
    program = multiprocessing.Process(target=fill_a_disk, args=(tmp_path, faults))
    program.start()
    program.join(60)
    sound, told, newest, sealed = faults.get()
    assert sound == [False, False, True]
    assert ("cannot be written" in told[0], told[1:]) == (True, [None])
    assert newest == [("After", True), ("Meanwhile 1", True), ("Meanwhile 0", True)]
    assert sealed[1] == "Before"
    assert sealed[2].startswith("A line of the journal was cut off here, after 100 bytes")
    assert sealed[3:] == ["Meanwhile 0", "Meanwhile 1", "After"]
    result = check_journal(tmp_path, [])
    assert (result.whole, result.lines, len(result.notes)) == (True, 6, 1)


def test_a_file_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    written(tmp_path)
    rotated = tmp_path / "journal.jsonl.1.gz"
    rotated.write_bytes(gzip.compress(b"x" * 1000)[:-5])
    with pytest.raises(JournalError, match=r"journal\.jsonl\.1\.gz: cannot be read to its end"):
        check_journal(tmp_path, [])


def test_a_deed_says_who_what_from_where_and_with_what_result(tmp_path: Path) -> None:
    """Halves of characters, which may stand in a request, do not keep it out of the journal."""
    told: list[JournalEntry] = []
    journal = Journal(tmp_path, ignore, told.append)
    journal.write_request(
        "start", "Start \ud800", client="192.0.2.7", result=Result.REFUSED, by="Ada", reason="Stop it first."
    )
    entry = told[-1]
    assert (entry.kind, entry.text, entry.by, entry.client) == (
        JournalKind.REQUEST,
        "Start ?: refused",
        "Ada",
        "192.0.2.7",
    )
    assert (entry.result, entry.reason) == (Result.REFUSED, "Stop it first.")
    copy = shutil.copytree(tmp_path, tmp_path / "copy")
    assert check_journal(copy, []).whole
