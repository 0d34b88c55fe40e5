"""Names of other people on the command line: printed as they are, never overwritten, labels alike everywhere."""

import itertools
import json
import re
from pathlib import Path

import pytest
from labview import made_up_grasp, write_log
from rich.table import Table
from typer.testing import CliRunner, Result

from app.cli import console
from app.cli.console import create_console
from app.cli.label_option import expand_label_arguments, parse_labels, parse_labels_of
from app.cli.main import app
from config.errors import ConfigurationError

NAMES = ["liver [old]", "a[/b]", "[red]x[/]", "x :warning: y", "a{b}", "<b>c</b>", "50 % & more", "[link=http://x]y"]


def called(*words: object) -> Result:
    result = CliRunner().invoke(app, [*map(str, words)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_printed_as_it_is_in_lines_and_tables(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    output = create_console()
    output.print(name, soft_wrap=True)
    table = Table("Held", title=name)
    table.add_row(name)
    output.print(table)
    assert capsys.readouterr().out.count(name) == 3


def test_no_command_makes_a_console_of_its_own() -> None:
    """A console of rich takes brackets for markup unless it is told otherwise."""
    for path in Path(console.__file__).parent.glob("*.py"):
        if path.name != "console.py":
            assert not re.search(r"(?<!create_)\bConsole\(", path.read_text(encoding="utf-8")), path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("names")
    for name in ("grasp_0.25Hz.lvm", "grasp_0.5Hz.LVM", "liver,left.lvm", "liver [old].lvm"):
        write_log(folder / name, made_up_grasp(400))
    return folder


def test_each_report_has_a_name_of_its_own_and_none_is_overwritten(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("grasp_0.25Hz.lvm", "grasp_0.5Hz.LVM", "grasp_0.5Hz.LVM"):
        called("report", folder / name)
    assert {path.stem for path in tmp_path.glob("*.html")} == {
        "report-grasp_0.25Hz",
        "report-grasp_0.5Hz",
        "report-grasp_0.5Hz-2",
    }


def test_a_label_takes_stems_with_points_names_with_commas_and_files_that_follow(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    labels = ["--label", "Liver=grasp_0.25Hz,liver,left.lvm", "--label", "bladder=grasp_0.5Hz.LVM", "liver [old].lvm"]
    called("report", "grasp_0.25Hz.lvm", "liver,left.lvm", *labels, "--out", tmp_path / "a.html")
    document = json.loads((tmp_path / "a.json").read_text())
    assert {one["title"]: one["held"] for one in document["recordings"]} == {
        "grasp_0.25Hz.lvm": "liver",
        "liver,left.lvm": "liver",
        "grasp_0.5Hz.LVM": "bladder",
        "liver [old].lvm": "bladder",
    }
    assert all("got no name" in one["advice"] or "No grasp" in one["advice"] for one in document["recordings"])


@pytest.mark.parametrize(
    "typed",
    [
        ["--label", "liver=a.lvm", "--label", "liver=b.lvm"],
        ["--label", "liver=a.lvm", "b.lvm"],
        ["--label=Liver=a.lvm", "b.lvm"],
        ["--label", "liver=a.lvm,b.lvm"],
        ["--label", "liver=a.lvm, b.lvm"],
        ["--label", "liver=[ab].lvm"],
    ],
)
def test_labels_mean_the_same_in_every_command(
    typed: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    files = [Path("a.lvm"), Path("b.lvm")]
    for path in files:
        path.touch()
    spread = expand_label_arguments(typed)
    labels = [arg.removeprefix("--label=") for arg in spread if arg.startswith("--label=")]
    labels += [after for before, after in itertools.pairwise(spread) if before == "--label"]
    assert set(parse_labels(labels)["liver"]) == set(files)
    for known in (files, []):
        of_report = parse_labels_of(labels, list(known))
        assert {(tissue, path) for tissue, paths in of_report for path in paths} == {("liver", path) for path in files}


def test_a_tissue_that_cannot_be_named_is_refused_by_every_command(folder: Path, tmp_path: Path) -> None:
    file = folder / "grasp_0.25Hz.lvm"
    for words in (
        ("report", file, "--label", f"2nd liver={file}"),
        ("learn", "--label", f"2nd liver={file}", "--out", tmp_path / "x.toml"),
        ("import", file, "--tissue", "2nd liver", "--data", tmp_path / "data"),
    ):
        with pytest.raises(ConfigurationError, match="with a letter first"):
            called(*words)
    assert not list(tmp_path.iterdir())
