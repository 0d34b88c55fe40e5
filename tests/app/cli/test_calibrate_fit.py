"""`graspwatch calibrate fit`, as somebody with paired recordings runs it: the real program and the files it leaves."""

import gzip
import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

GRASPWATCH = Path(sys.executable).parent / "graspwatch"
COLUMNS = "time=1,drive-position=2,drive-force=3,jaw-force=4"


def run_fit(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [GRASPWATCH, "calibrate", "fit", *words], capture_output=True, text=True, timeout=120, cwd=folder
    )


def write_bench(path: Path, load: float) -> None:
    """Write a recording whose jaw force is half the drive force, after a friction of 1."""
    t = np.linspace(0, 20, 2001)
    position = 50 * (1 - np.cos(t))
    jaw = load * (1 + position / 200)
    rows = np.column_stack([t, position, 2 * jaw + np.sign(np.sin(t)), jaw])
    text = "% bench\n" + "\n".join(",".join(f"{value:.5f}" for value in row) for row in rows) + "\n"
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    for load, name in ((1.0, "low.csv"), (2.0, "middle.csv"), (4.0, "high.csv.gz")):
        write_bench(tmp_path / name, load)
    return tmp_path


def test_the_map_is_printed_plotted_and_written(bench: Path) -> None:
    files = ["low.csv", "middle.csv", "high.csv.gz"]
    done = run_fit(bench, *files, "--columns", COLUMNS, "--out", "fit.toml", "--plot", "fit.html")
    assert done.returncode == 0, done.stderr
    assert all(each in done.stdout for each in (*files, "mean", "Standard uncertainty of a force"))
    table = tomllib.loads((bench / "fit.toml").read_text())["kinematics"]
    assert (table["kind"], table["source"]) == ("drive_fit", files)
    assert table["forward"]["per_drive_force"]["value"] == pytest.approx(0.5, abs=0.02)
    assert table["forward"]["offset"]["value"] == pytest.approx(-0.5, abs=0.05)
    assert table["backward"]["offset"]["value"] == pytest.approx(0.5, abs=0.05)
    assert 0 < table["residual_sd"] < 0.2
    assert (bench / "fit.html").read_text().count("Plotly.newPlot(") == 1


def test_one_file_is_fitted_and_the_note_says_what_it_cannot_show(bench: Path) -> None:
    done = run_fit(bench, "low.csv", "--columns", COLUMNS, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["mean_held_out_rms"] is None
    assert told["files"][0]["own_rms"] < 0.1
    assert "One file cannot show" in done.stderr


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["--columns", COLUMNS.replace("=4", "=9")], 3, "low.csv has 4 columns, and none at 9 for jaw-force"),
        (["--columns", "drive-force=3,jaw-force=4"], 2, "does not name drive-position"),
        (["--columns", "drive-force=three"], 2, "found: drive-force=three"),
        (["--columns", COLUMNS.replace("=4", "=3")], 2, "one column for two signals"),
        (["low.csv", "--columns", COLUMNS], 2, "named twice"),
        (["text.csv", "--columns", COLUMNS], 3, "text.csv, line 3: jaw-force is 'high', which is no number"),
        (["narrow.csv", "--columns", COLUMNS], 3, "narrow.csv has 3 columns, and none at 4"),
        (["still.csv", "--columns", COLUMNS], 8, "still.csv: drive-force is 0 all the time"),
        (["back.csv", "--columns", COLUMNS], 3, "back.csv: the time goes back from 20 to 0"),
        (["missing.csv", "--columns", COLUMNS], 3, "missing.csv: cannot be read"),
        (["--columns", COLUMNS, "--out", "no/fit.toml"], 2, "name another place with --out"),
    ],
)
def test_bad_input_is_one_message(bench: Path, words: list[str], code: int, says: str) -> None:
    rows = (bench / "low.csv").read_text().splitlines(keepends=True)
    (bench / "text.csv").write_text("".join([*rows[:2], "0.01,0,1,high\n", *rows[2:]]))
    (bench / "narrow.csv").write_text("1,2,3\n" * 200)
    (bench / "still.csv").write_text("".join(f"{n},{n % 50},0,{n % 7}\n" for n in range(200)))
    (bench / "back.csv").write_text("".join(rows + rows[1:]))
    before = sorted(bench.iterdir())
    done = run_fit(bench, "low.csv", *words)
    assert done.returncode == code, done.stderr
    assert says in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert done.stderr.count("Error") == 1
    assert sorted(bench.iterdir()) == before
