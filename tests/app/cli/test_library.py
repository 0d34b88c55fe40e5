"""`graspwatch library`, and a service that takes only approved libraries for a real tool."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.cli.main import app
from app.service.library_approvals import APPROVALS_FILE, LibraryApprovals
from config.errors import ConfigurationError, GraspwatchError
from config.load import CONFIG_DIR

TEXT = (CONFIG_DIR / "tissues" / "porcine.toml").read_text()


@pytest.fixture
def data(tmp_path: Path) -> Path:
    folder = tmp_path / "data"
    (folder / "tissues").mkdir(parents=True)
    (folder / "tissues" / "ward_3.toml").write_text(TEXT.replace('name = "porcine"', 'name = "ward_3"', 1))
    return folder


def command(*arguments: object) -> str:
    result = CliRunner().invoke(app, [*map(str, arguments)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.output


def serve(data: Path, tool: str) -> str:
    """What `serve` says to a tool with the own library: the first thing that keeps it from starting."""
    settings = data.parent / "settings.toml"
    shipped = (CONFIG_DIR / "graspwatch.toml").read_text()
    settings.write_text(shipped.replace('library = "porcine"', 'library = "ward_3"', 1))
    with pytest.raises(GraspwatchError) as error:
        command("serve", "--tool", tool, "--config", settings, "--data", data, "--tls-cert", data / "missing.pem")
    return str(error.value)


def listed(data: Path, *name: str) -> list[dict]:
    return json.loads(command("library", "list", *name, "--data", data, "--json"))


def test_a_decision_is_of_one_text_and_comes_back_with_it(data: Path) -> None:
    path = data / "tissues" / "ward_3.toml"
    assert [each["approval"] for each in listed(data)] == [None]
    command("library", "approve", "ward_3", "--reason", "judged on 40 spots", "--data", data)
    [approved] = listed(data)
    assert (approved["approval"]["approved"], approved["approval"]["reason"]) == (True, "judged on 40 spots")
    first = path.read_text()
    (data / "tissues" / "versions").mkdir()
    (data / "tissues" / "versions" / f"ward_3-{approved['version']}.toml").write_text(first)
    path.write_text(first + "# changed\n")
    assert [each["approval"] for each in listed(data)] == [None]
    command("library", "restore", "ward_3", approved["version"], "--data", data)
    assert path.read_text() == first
    now, *earlier = listed(data, "ward_3")
    assert now["current"]
    assert now["approval"]["approved"]
    assert {each["version"] for each in earlier} >= {approved["version"]}
    command("library", "withdraw", "ward_3", "--reason", "a label was wrong", "--data", data)
    assert [each["approval"]["approved"] for each in listed(data)] == [False]


def test_a_shipped_library_needs_no_approval_wherever_the_program_lies(data: Path, tmp_path: Path) -> None:
    linked = tmp_path / "linked"
    linked.symlink_to(CONFIG_DIR)
    for folder in (CONFIG_DIR, linked):
        LibraryApprovals(data).check(folder / "tissues" / "porcine.toml", "porcine")


def test_a_line_that_a_full_disk_cut_off_does_not_spoil_the_next_one(data: Path) -> None:
    command("library", "approve", "ward_3", "--reason", "judged", "--data", data)
    path = data / APPROVALS_FILE
    path.write_bytes(path.read_bytes() + b'{"sha256": "1')
    with pytest.raises(ConfigurationError, match="line 2: is no approval"):
        listed(data)
    LibraryApprovals(data).add("ward_4", "text", approved=True, reason="judged", by=None)
    assert len(path.read_bytes().splitlines()) == 3


def test_a_real_tool_takes_an_approved_library_only(data: Path) -> None:
    assert "'ward_3' is not approved for a real tool" in serve(data, "nidaq")
    assert "approved" not in serve(data, "simulated")
    command("library", "approve", "ward_3", "--reason", "judged on 40 spots", "--data", data)
    assert "approved" not in serve(data, "nidaq")
    command("library", "withdraw", "ward_3", "--reason", "a label was wrong", "--data", data)
    assert "is no longer approved (a label was wrong)" in serve(data, "nidaq")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("approve", "ward_4", "--reason", "good"), "there is no such file"),
        (("approve", "ward_3", "--reason", " "), "say why"),
        (("restore", "ward_3", "0123456789abcdef"), "no version '0123456789abcdef'"),
        (("list", "ward_4"), "no own library 'ward_4'"),
    ],
)
def test_what_is_not_there_is_told(data: Path, arguments: tuple[str, ...], told: str) -> None:
    with pytest.raises(ConfigurationError, match=re.escape(told)):
        command("library", *arguments, "--data", data)


def test_a_broken_file_of_approvals_is_told_with_its_line(data: Path) -> None:
    command("library", "approve", "ward_3", "--reason", "judged", "--data", data)
    with (data / APPROVALS_FILE).open("a") as file:
        file.write("[]\n")
    with pytest.raises(ConfigurationError, match="line 2: is no approval"):
        listed(data)
