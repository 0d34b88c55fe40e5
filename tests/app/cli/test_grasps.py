"""`label`, `grasps` and `evaluate` on recordings of a data folder that no service uses."""

import subprocess
from pathlib import Path

import pyarrow.parquet
import pytest
from service import PROGRAM


def graspwatch(*words: object) -> tuple[int, str, str]:
    done = subprocess.run([PROGRAM, *map(str, words)], capture_output=True, text=True, env=None)
    return done.returncode, done.stdout, " ".join(done.stderr.split())


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("laboratory")
    (folder / "recordings").mkdir()
    path = folder / "recordings/first.mcap"
    done = graspwatch("run", "trapezoid_4hz", "--tissue", "bladder", "--cycles", 3, "--record", path)
    assert done[0] == 0, done[2]
    (folder / "recordings/demo-second.mcap").write_bytes(path.read_bytes())
    return folder


def table(data: Path, tmp_path: Path, *words: object) -> list[dict]:
    out = tmp_path / "grasps.parquet"
    code, told, errors = graspwatch("grasps", "--all", "--data", data, "--out", out, *words)
    assert code == 0, errors
    rows = pyarrow.parquet.read_table(out).to_pylist()
    assert told.startswith(f"{out}: {len(rows)} grasps of 1 recordings")  # the demonstration's is left out
    return rows


def test_a_label_is_in_the_table_and_a_correction_needs_a_reason(data: Path, tmp_path: Path) -> None:
    def label(*words: object) -> tuple[int, str, str]:
        return graspwatch("label", "first", "--data", data, *words)

    assert label("--held", "Small bowel", "--grasp", 2)[1] == "first.mcap: 1 of 3 grasps labeled\n"
    code, _, errors = label("--held", "bladder")
    assert (code, "Grasp 2 has a statement already. Say with --why" in errors) == (2, True)
    assert label("--held", "bladder", "--grasp", 2, "--why", "seen on the video")[0] == 0
    assert label("--remark", "slipped", "--grasp", 3)[0] == 0
    for words, code, told in (
        ((), 2, "Say what was held with --held, --remark or --place"),
        (("--held", "liver", "--grasp", 4), 3, "first.mcap has no grasp 4: it has 3."),
        (("--held", "unknown"), 2, "is reserved"),
    ):
        refused = label(*words)
        assert (refused[0], told in refused[2]) == (code, True), refused
    elsewhere = graspwatch("label", data / "recordings/first", "--held", "liver", "--data", data)
    assert (elsewhere[0], "There is no recording" in elsewhere[2]) == (3, True)

    rows = table(data, tmp_path)
    assert [(row["index"], row["truth"], row["truth_remark"], row["truth_version"]) for row in rows] == [
        (1, None, None, None),
        (2, "bladder", None, 2),
        (3, None, "slipped", 1),
    ]
    (tmp_path / "grasps.parquet").unlink()
    (data / "index.sqlite").unlink()  # the journal has them all
    assert [row["truth"] for row in table(data, tmp_path)] == [None, "bladder", None]


def test_the_table_is_filtered_and_estimated_anew(data: Path, tmp_path: Path) -> None:
    as_recorded = table(data, tmp_path, "--where", "valid=true", "--where", "index>=2")
    assert [row["index"] for row in as_recorded] == [2, 3]
    (tmp_path / "grasps.parquet").unlink()
    anew = table(data, tmp_path, "--library", "porcine", "--where", "index>=2")
    assert [row["label"] for row in anew] == [row["label"] for row in as_recorded]
    for name in ("dose_n_s", "start_s", "contact_s", "end_s"):  # times count from the run's first sample in both
        assert [row[name] for row in anew] == pytest.approx([row[name] for row in as_recorded])
    for row in anew:  # 3 V for a quarter of a second: the dose is at most the peak over the whole grasp
        assert 0.0 < row["dose_n_s"] < row["peak_force_n"] * (row["end_s"] - row["start_s"])
        assert row["time_above_s_low"] >= row["time_above_s_high"] >= 0.0
    for words, told in (
        (("--where", "colour=red"), "no grasp has a value there. Columns: recording,"),
        (("--where", "index>many"), "the column holds numbers"),
        (("--where", "index"), "expected a column"),
        (("--where", "index>7"), "None of the 3 grasps fulfils --where"),
        (("--out", tmp_path / "grasps.txt"), "must end with .parquet or .csv"),
        (("--out", tmp_path / "grasps.parquet"), "exists already, and is kept"),
    ):
        refused = graspwatch("grasps", "--all", "--data", data, *words)
        assert (refused[0], told in refused[2]) == (2, True), refused


def test_a_recording_that_cannot_be_read_is_left_out_of_all_and_refused_by_name(data: Path, tmp_path: Path) -> None:
    broken = data / "recordings/third.mcap"
    broken.write_bytes(b"no recording")
    try:
        code, told, errors = graspwatch("grasps", "--all", "--data", data)
        assert (code, "3 grasps" in told) == (0, True), errors
        assert f"Left out: {broken}" in errors
        code, _, errors = graspwatch("grasps", "--all", broken, "--data", data)
        assert (code, str(broken) in errors) == (3, True)
    finally:
        broken.unlink()


def test_a_label_counts_however_the_file_is_named(data: Path) -> None:
    words = [PROGRAM, "grasps", "--all", "recordings/first.mcap", "--data", data]
    named = ["--label", "spleen=recordings/first.mcap", "--where", "truth=spleen"]
    done = subprocess.run([*words, *named], capture_output=True, text=True, cwd=data)
    assert (done.returncode, "spleen" in done.stdout) == (0, True), done.stderr


def test_answers_are_judged_by_the_labels(data: Path, tmp_path: Path) -> None:
    code, told, errors = graspwatch("evaluate", "--all", "--data", data, "--out", tmp_path, "--library", "porcine")
    assert code == 0, errors
    assert "named right" in told
    assert "By truth: porcine" in (tmp_path / "study-evaluate.html").read_text()
