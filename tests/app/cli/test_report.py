"""`graspwatch report`, as a person calls it: what it writes, and each refusal."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from simulation import joined, simulate_raw, write_lvm
from typer.testing import CliRunner

from app.analysis.report.page import PAGE_KIND
from app.cli.main import app
from config.errors import ConfigurationError, GraspwatchError, RecordingError

PROGRAM = Path(sys.executable).with_name("graspwatch")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    for tissue in ("liver", "bladder"):
        write_lvm(folder / f"{tissue}.lvm", joined(simulate_raw(tissue, "trapezoid_4hz", cycles=3)))
    (folder / "broken.lvm").write_text("LabVIEW Measurement\n")
    return folder


def called(*words):
    """Without a process of its own, which costs seconds; an error is raised as `main` gets it."""
    result = CliRunner().invoke(app, ["report", *map(str, words)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_it_writes_a_page_and_a_json_and_prints_the_same_json(folder):
    files = [folder / "liver.lvm", folder / "bladder.lvm"]
    words = [*files, "--tool", "simulated", "--label", f"liver={files[0]}", "--label", "bladder=bladder"]
    done = subprocess.run(
        [PROGRAM, "report", *words, "--out", folder / "two.html", "--json"],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "COLUMNS": "200"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout, parse_constant=lambda word: pytest.fail(f"{word} in the JSON"))
    assert document == json.loads((folder / "two.json").read_text())
    assert [one["held"] for one in document["recordings"]] == ["liver", "bladder"]
    assert [len(one["grasps"]) for one in document["recordings"]] == [3, 3]
    assert {table["title"].split(":")[0] for table in document["tables"]} >= {"Table VI", "Table VII"}
    page = (folder / "two.html").read_text()
    assert f'content="{PAGE_KIND}"' in page
    spots = page.split("One answer for each spot")[-1].split("</table>")[0]
    for recording in document["recordings"]:
        (spot,) = recording["spots"]
        assert spot["grasps"] == [1, 2, 3]
        assert (recording["title"] in spots, spot["label"].capitalize() in spots) == (True, True)


def test_an_earlier_report_is_replaced_and_its_verdicts_are_shown(folder):
    for _ in range(2):
        result = called(folder / "liver.lvm", "--tool", "simulated", "--out", folder / "again.html")
    assert "3 grasps" in result.output
    assert str(folder / "again.json") in result.output.replace("\n", "")
    assert not [*folder.glob(".*")]


def test_a_recording_of_the_data_folder_is_found_by_its_name(folder, tmp_path):
    data = tmp_path / "data"
    (data / "recordings").mkdir(parents=True)
    (data / "recordings" / "run-7.lvm").write_bytes((folder / "liver.lvm").read_bytes())
    called("run-7", "--data", data, "--tool", "simulated", "--out", tmp_path / "run.html")
    assert json.loads((tmp_path / "run.json").read_text())["report"] == "Report: run-7.lvm"


def test_a_name_is_a_name_and_no_part_of_the_page(folder, tmp_path):
    path = tmp_path / "<b onclick=x>'&amp.lvm"
    path.write_bytes((folder / "liver.lvm").read_bytes())
    called(path, "--tool", "simulated", "--out", tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert "<b onclick" not in text
    assert "&lt;b onclick=x&gt;&#39;&amp;amp.lvm" in text


@pytest.mark.parametrize(
    ("words", "error", "told"),
    [
        (["{f}/none.lvm"], ConfigurationError, "there is no such file, and no such recording in"),
        (["{f}/broken.lvm"], RecordingError, "broken.lvm"),
        (["{f}/liver.lvm", "{f}/liver.lvm"], ConfigurationError, "named twice"),
        (["{f}/liver.lvm", "--label", "liver"], ConfigurationError, "expected TISSUE=FILE"),
        (["{f}/liver.lvm", "--label", "livr=liver"], ConfigurationError, "Did you mean 'liver'?"),
        (["{f}/liver.lvm", "--label", "Liver!=liver"], ConfigurationError, "small letters"),
        (["{f}/liver.lvm", "--label", "liver=bladder"], ConfigurationError, "none of the recordings"),
        (["{f}/liver.lvm", "--label", "liver=liver,liver.lvm"], ConfigurationError, "a label already"),
        (["{f}/liver.lvm", "--out", "{f}/page.txt"], ConfigurationError, "must end in .html"),
        (["{f}/liver.lvm", "--out", "{f}/no/page.html"], ConfigurationError, "there is no folder"),
        (["{f}/liver.lvm", "--out", "{f}/taken.html"], ConfigurationError, "is no report"),
        (["{f}/liver.lvm", "--out", "{f}/half.html"], ConfigurationError, "half.json is there already"),
        (["{f}/liver.lvm", "--library", "porcin"], ConfigurationError, "porcine"),
        (["{f}/liver.lvm", "--tool", "no_tool"], ConfigurationError, "no_tool"),
    ],
)
def test_wrong_input_is_refused_in_one_message_and_nothing_is_written(folder, words, error, told):
    (folder / "taken.html").write_text("<title>mine</title>")
    (folder / "half.json").write_text("{}")
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    with pytest.raises(GraspwatchError) as refused:
        called(*(word.format(f=folder) for word in words))
    assert isinstance(refused.value, error)
    assert told in str(refused.value)
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before


def test_a_recording_without_a_grasp_has_a_page_that_says_so(tmp_path):
    quiet = joined(simulate_raw("liver", "trapezoid_4hz", cycles=1))
    write_lvm(
        tmp_path / "quiet.lvm", replace(quiet, signals={name: values[:400] for name, values in quiet.signals.items()})
    )
    called(tmp_path / "quiet.lvm", "--tool", "simulated", "--out", tmp_path / "quiet.html")
    assert "No grasp was found" in (tmp_path / "quiet.html").read_text()
