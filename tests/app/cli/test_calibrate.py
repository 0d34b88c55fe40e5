"""`graspwatch calibrate`, as somebody at the bench runs it: the real program, what it asks, and the files it leaves."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

GRASPWATCH = Path(sys.executable).parent / "graspwatch"


def calibrate(folder: Path, *words: str, answers: str | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [GRASPWATCH, "calibrate", *words], capture_output=True, text=True, timeout=120, cwd=folder, input=answers
    )


@pytest.mark.long
def test_one_calibration_builds_on_the_other_and_the_last_file_holds_all(tmp_path: Path) -> None:
    tool, files = "simulated", []
    for words in (
        ["tare"],
        ["strain", "--weights", "0,5,10,15,0"],
        ["stretch"],
        ["geometry", "--gauges", "0,3,6"],
        ["force"],
    ):
        done = calibrate(tmp_path, *words, "--tool", tool, "--yes", "--json", "--person", "a test")
        assert done.returncode == 0, done.stderr
        told = json.loads(done.stdout)
        for constant in told["constants"]:
            assert constant["low"] <= constant["value"] <= constant["high"]
            assert constant["value"] == pytest.approx(constant["was"], rel=0.01)  # the simulated truth
        tool = told["file"]
        files.append(tmp_path / tool)
        assert (tmp_path / told["plot"]).read_text().count("Plotly.newPlot(") == 1
    assert len({*files}) == 5
    assert all(path.exists() for path in files)
    calibration = tomllib.loads(files[-1].read_text())["calibration"]
    assert calibration["jaw_force_scale"]["measured"]
    measured = calibration["measured"]
    assert {each["constant"] for each in measured} == {
        "rest_offset_v",
        "strain_sd_v",
        "newton_per_volt",
        "encoder_deg_per_volt",
        "handle_per_encoder",
        "opening_m",
    }


def test_nothing_moves_and_nothing_is_written_unless_somebody_agrees(tmp_path: Path) -> None:
    done = calibrate(tmp_path, "stretch")
    assert done.returncode == 2
    assert "Nobody is at a terminal" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["strain", "--weights", "0,two,4", "--yes"], 2, "numbers with commas between"),
        (["strain", "--weights", "0,2,4", "--yes"], 8, "3 different pulls tell no line from a curve"),
        (["geometry", "--gauges", "0,0,2", "--yes"], 8, "At least 3 gauges"),
        (["force", "--forces", "1,2,3,4,5", "--yes"], 8, "the first one 0"),
        (["stretch", "missing.lvm", "--yes"], 3, "missing.lvm"),
        (["tare", "--tool", "smart_tool_2013", "--yes"], 2, "is for recordings"),
        (["tare", "--yes", "--into", "/proc/no"], 2, "name another folder (--into)"),
    ],
)
def test_what_cannot_be_is_told_in_one_message(tmp_path: Path, words: list[str], code: int, says: str) -> None:
    done = calibrate(tmp_path, *words)
    assert (done.returncode, says in done.stderr, "Traceback" in done.stderr) == (code, True, False), done.stderr
    assert not list(tmp_path.iterdir())


def test_recordings_whose_encoder_slips_leave_no_file(recordings: list[Path], tmp_path: Path) -> None:
    [slips] = [path for path in recordings if path.name.startswith("ureter4Hz1")]
    done = calibrate(tmp_path, "stretch", str(slips))
    assert done.returncode == 8
    assert "the encoder slips" in done.stderr
    assert "Nothing was written" in done.stderr
    assert not list(tmp_path.iterdir())
