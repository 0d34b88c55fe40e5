"""The bin on a disk: entries by the moment of their deletion, and nothing lost or overwritten on the way."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from app.bin import Bin, expired
from config.errors import RefusedError

NOW = datetime(2026, 3, 1, 12, 0, 0, 250, UTC)


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    for name in ("a.mcap", "b.lvm"):
        (tmp_path / name).write_text(name)
    return tmp_path


def test_deleted_recordings_are_listed_last_first_and_come_back(recordings: Path) -> None:
    waste = Bin(recordings)
    assert waste.files() == []
    waste.put(recordings / "a.mcap", NOW)
    waste.put(recordings / "b.lvm", NOW + timedelta(seconds=1))
    assert [(file.name, file.size_bytes) for file in waste.files()] == [("b.lvm", 5), ("a.mcap", 6)]
    assert waste.files()[1].deleted_at == NOW
    assert not list(recordings.glob("*.*"))
    assert waste.restore(waste.find(waste.files()[1].entry)).read_text() == "a.mcap"
    assert [file.name for file in waste.files()] == ["b.lvm"]


def test_one_name_is_deleted_twice_and_neither_takes_the_others_place(recordings: Path) -> None:
    waste = Bin(recordings)
    waste.put(recordings / "a.mcap", NOW)
    (recordings / "a.mcap").write_text("the second")
    waste.put(recordings / "a.mcap", NOW + timedelta(microseconds=1))
    second, first = waste.files()
    waste.restore(second)
    with pytest.raises(RefusedError, match=r"another recording 'a\.mcap'"):
        waste.restore(first)
    assert (recordings / "a.mcap").read_text() == "the second"
    assert first.path.read_text() == "a.mcap"


def test_what_cannot_be_moved_stays_where_it_is(recordings: Path) -> None:
    waste = Bin(recordings)
    with pytest.raises(FileNotFoundError):
        waste.put(recordings / "c.lvm", NOW)
    assert waste.files() == []
    waste.put(recordings / "a.mcap", NOW)
    with pytest.raises(FileExistsError):
        waste.put(recordings / "b.lvm", NOW)
    assert (recordings / "b.lvm").exists()


def test_a_long_name_fits(recordings: Path) -> None:
    path = recordings / f"{'x' * 251}.lvm"
    path.write_text("")
    Bin(recordings).put(path, NOW)
    assert Bin(recordings).files()[0].name == path.name


def test_what_is_no_entry_is_passed_over(recordings: Path) -> None:
    waste = Bin(recordings)
    waste.put(recordings / "a.mcap", NOW)
    folder = waste.files()[0].path.parents[1]
    (folder / "notes").mkdir()
    (folder / "20269999T000000000000Z").mkdir()
    (folder / "20260101T000000000000Z").touch()
    assert [file.name for file in waste.files()] == ["a.mcap"]
    for entry in ("notes", "..", "", "20269999T000000000000Z"):
        with pytest.raises(RefusedError, match="no entry"):
            waste.find(entry)


def test_age_counts_from_the_deletion(recordings: Path) -> None:
    waste = Bin(recordings)
    waste.put(recordings / "a.mcap", NOW - timedelta(days=31))
    waste.put(recordings / "b.lvm", NOW - timedelta(days=29))
    files = waste.files()
    assert [file.name for file in expired(files, 30.0, NOW)] == ["a.mcap"]
    assert expired(files, 0.0, NOW) == files
    waste.remove(files[1])
    assert [file.name for file in waste.files()] == ["b.lvm"]
