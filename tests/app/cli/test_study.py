"""`graspwatch study`, as a researcher runs it: the real program, its page, its JSON, its refusals."""

import html
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

GRASPWATCH = Path(sys.executable).parent / "graspwatch"
SMALL = {
    "paper": ["--seeds", "1"],
    "identify": ["--grasps", "3"],
    "repeated": ["--grasps", "1"],
    "unknown": ["--grasps", "1"],
    "initial": ["--grasps", "1"],
    "mismatch": ["--grasps", "1"],
    "estimators": ["--grasps", "1"],
    "limiter": ["--grasps", "10"],
}


def study(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "COLUMNS": "200"}
    return subprocess.run(
        [GRASPWATCH, "study", *words], cwd=folder, env=environment, capture_output=True, text=True, timeout=170
    )


LONG = {"paper", "estimators", "initial", "mismatch", "identify", "limiter"}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.long] * (name in LONG)) for name in SMALL])
def test_a_study_prints_its_figures_and_writes_a_page_and_a_json(name, tmp_path):
    done = study(name, *SMALL[name], "--json", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    printed = json.loads(done.stdout, parse_constant=lambda word: pytest.fail(f"{word} in the JSON"))
    assert printed == json.loads((tmp_path / "studies" / f"study-{name}.json").read_text())
    assert printed["study"] == name
    assert all(figure["value"] is not None for figure in printed["figures"])
    page = html.unescape((tmp_path / "studies" / f"study-{name}.html").read_text())
    for figure in printed["figures"]:
        assert figure["name"].split(":")[0] in page
    assert "Plotly" in page
    assert not re.search(r"""<(script|link|img)[^>]+(src|href)=["']?http""", page)  # nothing is fetched


def test_without_a_terminal_a_study_says_once_how_long_it_will_take(tmp_path):
    done = study("identify", "--grasps", "20", "--jobs", "1", "--json", folder=tmp_path)
    assert done.stderr.count("s left.") == 1


def test_the_same_seed_gives_the_same_figures_however_many_processes(tmp_path):
    one, two, other = (
        json.loads(study("unknown", "--grasps", "1", *words, "--json", folder=tmp_path).stdout)["figures"]
        for words in (["--jobs", "1"], ["--jobs", "2"], ["--seed", "1"])
    )
    assert one == two
    assert one != other


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["identify", "--protocol", "trapezoid_3hz"], "Did you mean"),
        (["identify", "--library", "human"], "There is: "),
        (["identify", "--noise-mv", "-1"], "noise-mv"),
        (["identify", "--grasps", "0"], "grasps"),
        (["everything"], "everything"),
    ],
)
def test_wrong_input_is_refused_in_one_message(words, told, tmp_path):
    done = study(*words, folder=tmp_path)
    assert done.returncode == 2
    assert told in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "studies").exists()
