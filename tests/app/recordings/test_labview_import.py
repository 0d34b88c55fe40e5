"""Imports of LabVIEW logs: names, times, and that nothing is left behind or overwritten."""

import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labview import Dialect, made_up_grasp, write_log
from typer.testing import CliRunner, Result

from acquisition.recordings.file_names import check_run_name, remove_recording_suffix, to_printable
from acquisition.recordings.mcap_reader import McapFile
from app.cli.main import app
from app.recordings.run_reader import read_run
from config.errors import ConfigurationError, GraspwatchError, RecordingError

SAMPLES = made_up_grasp(400)


def called(*words: object) -> Result:
    """Run a command in this process; an error is raised as `main` gets it."""
    result = CliRunner().invoke(app, [*map(str, words)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def import_into(data: Path, *words: object) -> Result:
    return called("import", *words, "--data", data)


def recordings_of(data: Path) -> list[str]:
    return sorted(path.name for path in (data / "recordings").iterdir() if path.is_file())


def test_a_log_is_imported_at_its_own_time_whatever_day_it_is(tmp_path: Path) -> None:
    log = write_log(tmp_path / "LIVER 0.25Hz.LVM", SAMPLES, Dialect(volts="mV"))
    result = import_into(tmp_path / "data", log, "--tissue", "Small bowel")
    assert "was converted from mV to V" in result.output
    run = read_run(tmp_path / "data" / "recordings" / "LIVER 0.25Hz.mcap")
    assert run.metadata["recorded_at"] == run.run.started_at == "2024-03-05T10:11:12.500000+00:00"
    assert run.run.ended_at == "2024-03-05T10:11:12.900000+00:00"
    assert run.log_ns[0] == 1_709_633_472_500_000_000
    assert (run.run.id, run.run.tissue) == ("LIVER 0.25Hz", "small_bowel")
    assert "converted from mV" in run.metadata["imported_remarks"]


def test_a_log_without_a_date_says_that_the_files_is_taken(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.lvm", SAMPLES)
    lines = [line for line in log.read_text().splitlines() if not line.startswith(("Date\t", "Time\t"))]
    log.write_text("\n".join(lines) + "\n")
    os.utime(log, (1_000_000_000, 1_000_000_000))
    result = import_into(tmp_path / "data", log)
    assert "does not say when it began" in result.output
    assert read_run(tmp_path / "data" / "recordings" / "a.mcap").log_ns[0] == 10**18


def test_several_files_go_on_after_one_that_fails_and_say_so_at_the_end(tmp_path: Path) -> None:
    good = [write_log(tmp_path / name, SAMPLES) for name in ("a.lvm", "b.lvm")]
    broken = tmp_path / "broken.lvm"
    broken.write_text("LabVIEW Measurement\n")
    with pytest.raises(RecordingError, match=r"1 of 3 files were not imported: .*broken\.lvm"):
        import_into(tmp_path / "data", good[0], broken, good[1])
    assert recordings_of(tmp_path / "data") == ["a.mcap", "b.mcap"]


def test_what_fails_leaves_nothing_behind_and_can_be_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = write_log(tmp_path / "a.lvm", SAMPLES)

    def fail(*_: object) -> None:
        raise UnicodeEncodeError("utf-8", "\udce4", 0, 1, "surrogates not allowed")

    with monkeypatch.context() as broken:
        broken.setattr("app.recordings.mcap_writer.McapRunWriter._build_metadata", fail)
        with pytest.raises(UnicodeEncodeError):
            import_into(tmp_path / "data", log)
    assert recordings_of(tmp_path / "data") == []
    import_into(tmp_path / "data", log)
    assert recordings_of(tmp_path / "data") == ["a.mcap"]


def test_nothing_is_overwritten_and_another_name_can_be_given(tmp_path: Path) -> None:
    log, data = write_log(tmp_path / "a.lvm", SAMPLES), tmp_path / "data"
    import_into(data, log)
    before = (data / "recordings" / "a.mcap").read_bytes()
    with pytest.raises(RecordingError, match=r"exists already, and is kept.*--name"):
        import_into(data, log)
    import_into(data, log, "--name", "a, second [left]")
    assert recordings_of(data) == ["a, second [left].mcap", "a.mcap"]
    assert (data / "recordings" / "a.mcap").read_bytes() == before
    with pytest.raises(ConfigurationError, match="--name is for one file"):
        import_into(data, log, log, "--name", "b")


def test_a_file_name_that_is_no_utf_8_needs_another_one(tmp_path: Path) -> None:
    log = Path(os.fsdecode(os.fsencode(tmp_path) + b"/l\xe4ber.lvm"))
    write_log(log, SAMPLES)
    with pytest.raises(GraspwatchError, match=r"is not UTF-8\. Give another one with --name"):
        import_into(tmp_path / "data", log)
    assert recordings_of(tmp_path / "data") == []
    import_into(tmp_path / "data", log, "--name", "laeber")
    assert McapFile(tmp_path / "data" / "recordings" / "laeber.mcap").metadata["imported_from"] == "l\\xe4ber.lvm"


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("", "it is empty"),
        ("a/b", "slash"),
        ("a\\b", "slash"),
        (".hidden", "begins with '.'"),
        ("-x", "begins with '-'"),
        ("demo-7", "kept for demonstrations"),
        ("two\nlines", "cannot be printed"),
        (" a", "space"),
        ("ä" * 101, "more than 200 bytes"),
        ("l\udce4ber", "not UTF-8"),
    ],
)
def test_a_name_that_would_not_work_somewhere_is_refused(name: str, told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        check_run_name(name, "Choose another.")


@settings(max_examples=15, deadline=None)
@given(name=st.text(min_size=1, max_size=20))
def test_every_name_that_is_accepted_is_recorded_listed_and_exported(
    tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    try:
        check_run_name(name, "")
    except ConfigurationError:
        return
    folder = tmp_path_factory.mktemp("named")
    import_into(folder / "data", write_log(folder / "a.lvm", SAMPLES), "--name", name)
    assert recordings_of(folder / "data") == [f"{name}.mcap"]
    for kind in ("csv", "mat"):
        called("export", name, "--data", folder / "data", "--format", kind, "--out", folder / f"out.{kind}")
    assert read_run(folder / "data" / "recordings" / f"{name}.mcap").run.id == name


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("a.lvm", "a"),
        ("A.LVM.GZ", "A"),
        ("grasp_0.25Hz.lvm", "grasp_0.25Hz"),
        ("x.mcap", "x"),
        ("x.lvm.lvm", "x.lvm"),
        ("notes.pdf", "notes.pdf"),
    ],
)
def test_only_the_ending_of_a_recording_is_taken_from_its_name(name: str, stem: str) -> None:
    assert remove_recording_suffix(name) == stem


def test_a_name_is_shown_with_escapes_where_it_is_no_text() -> None:
    assert to_printable("l\udce4ber [1]") == "l\\xe4ber [1]"
