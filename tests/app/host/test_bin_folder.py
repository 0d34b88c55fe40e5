"""The bin on a disk: entries by the moment of their deletion, and nothing lost or overwritten on the way."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from app.host.bin_folder import BinFolder, find_expired
from config.errors import RefusedError

NOW = datetime(2026, 3, 1, 12, 0, 0, 250, UTC)


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    for name in ("a.mcap", "b.lvm"):
        (tmp_path / name).write_text(name)
    return tmp_path


def test_deleted_recordings_are_listed_last_first_and_come_back(recordings: Path) -> None:
    waste = BinFolder(recordings)
    assert waste.list_files() == []
    waste.add(recordings / "a.mcap", NOW)
    waste.add(recordings / "b.lvm", NOW + timedelta(seconds=1))
    assert [(file.name, file.size_bytes) for file in waste.list_files()] == [("b.lvm", 5), ("a.mcap", 6)]
    assert waste.list_files()[1].deleted_at == NOW
    assert not list(recordings.glob("*.*"))
    assert waste.restore(waste.find(waste.list_files()[1].entry)).read_text() == "a.mcap"
    assert [file.name for file in waste.list_files()] == ["b.lvm"]


def test_one_name_is_deleted_twice_and_neither_takes_the_others_place(recordings: Path) -> None:
    waste = BinFolder(recordings)
    waste.add(recordings / "a.mcap", NOW)
    (recordings / "a.mcap").write_text("the second")
    waste.add(recordings / "a.mcap", NOW + timedelta(microseconds=1))
    second, first = waste.list_files()
    waste.restore(second)
    with pytest.raises(RefusedError, match=r"another recording 'a\.mcap'"):
        waste.restore(first)
    assert (recordings / "a.mcap").read_text() == "the second"
    assert first.path.read_text() == "a.mcap"


def test_what_cannot_be_moved_stays_where_it_is(recordings: Path) -> None:
    waste = BinFolder(recordings)
    with pytest.raises(FileNotFoundError):
        waste.add(recordings / "c.lvm", NOW)
    assert waste.list_files() == []
    waste.add(recordings / "a.mcap", NOW)
    with pytest.raises(FileExistsError):
        waste.add(recordings / "b.lvm", NOW)
    assert (recordings / "b.lvm").exists()


def test_a_long_name_fits(recordings: Path) -> None:
    path = recordings / f"{'x' * 251}.lvm"
    path.write_text("")
    BinFolder(recordings).add(path, NOW)
    assert BinFolder(recordings).list_files()[0].name == path.name


def test_what_is_no_entry_is_passed_over(recordings: Path) -> None:
    waste = BinFolder(recordings)
    waste.add(recordings / "a.mcap", NOW)
    folder = waste.list_files()[0].path.parents[1]
    (folder / "notes").mkdir()
    (folder / "20269999T000000000000Z").mkdir()
    (folder / "20260101T000000000000Z").touch()
    assert [file.name for file in waste.list_files()] == ["a.mcap"]
    for entry in ("notes", "..", "", "20269999T000000000000Z"):
        with pytest.raises(RefusedError, match="no entry"):
            waste.find(entry)


def test_age_counts_from_the_deletion(recordings: Path) -> None:
    waste = BinFolder(recordings)
    waste.add(recordings / "a.mcap", NOW - timedelta(days=31))
    waste.add(recordings / "b.lvm", NOW - timedelta(days=29))
    files = waste.list_files()
    assert [file.name for file in find_expired(files, 30.0, NOW)] == ["a.mcap"]
    assert find_expired(files, 0.0, NOW) == files
    waste.delete_permanently(files[1])
    assert [file.name for file in waste.list_files()] == ["b.lvm"]
