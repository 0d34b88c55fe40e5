"""Commands that only read: they work on a copy that nobody can write to, and make no folder of a mistyped name."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from service import Service
from typer.main import get_command

from app.cli.main import app, expand_paths
from app.messages.people import Role
from app.people import tokens
from config.errors import ConfigurationError
from config.load import CONFIG_DIR

STORED = Path(__file__).parents[2] / "stored_before"
RUN = "20261130-030315-68cf-001"
MISTYPED = "no/such"
ALL_IN_ONE_PROCESS = """
import contextlib, io, json, sys
from app.cli.main import main
answers = []
for words in json.loads(sys.argv[1]):
    sys.argv = ["graspwatch", *words]
    out, error, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    answers.append([code, out.getvalue(), error.getvalue()])
print(json.dumps(answers))
"""
READ_ONLY = 'mount --bind "$0" "$0" && mount -o remount,ro,bind "$0" && exec "$@"'


def called(folder: Path, commands: list[list[str]], within: list[str]) -> list[Any]:
    """Run commands one after the other in one process of the program; return exit code, output and error output."""
    program = [*within, sys.executable, "-c", ALL_IN_ONE_PROCESS, json.dumps(commands)]
    done = subprocess.run(
        program, capture_output=True, text=True, timeout=300, cwd=folder, env={**os.environ, "COLUMNS": "300"}
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_copy_that_nobody_can_write_to_is_read(tmp_path: Path) -> None:
    data, work = tmp_path / "data", tmp_path / "work"
    (data / "recordings").mkdir(parents=True)
    work.mkdir()
    recording = shutil.copy(STORED / f"{RUN}.mcap", data / "recordings")
    shutil.copy(STORED / "journal.jsonl", data)
    index = sqlite3.connect(data / "index.sqlite")
    index.execute("PRAGMA journal_mode=WAL")
    index.executescript((STORED / "index.sql").read_text())
    index.close()
    before = sorted(path.relative_to(data) for path in data.rglob("*"))
    commands = [
        ["index", "--json", "--data", str(data)],
        ["audit", "verify", "--data", str(data)],
        ["audit", "export", "--out", "journal.csv", "--data", str(data)],
        ["token", "list", "--data", str(data)],
        ["export", RUN, "--format", "csv", "--data", str(data)],
        ["report", RUN, "--data", str(data)],
        ["replay", str(recording)],
        ["support", "--out", "help.zip", "--data", str(data)],
    ]
    answers = called(work, commands, ["unshare", "-m", "sh", "-c", READ_ONLY, str(data)])
    for words, (code, _, error) in zip(commands, answers, strict=True):
        assert code == 0, (words, error)
    assert json.loads(answers[0][1])["counts"]["files"] == 1
    assert "not asked" not in answers[1][1], "the index was asked, too"
    assert sorted(path.relative_to(data) for path in data.rglob("*")) == before


FULL_DISK = """
mount -t tmpfs -o size=12k none "$0" && cd "$0" && head -c 8k /dev/zero >filler && mkdir full &&
mount -t tmpfs -o size=4k none full && head -c 4k /dev/zero >full/filler && "$@"; find . -type f >"$0.left"
"""


def test_a_full_disk_ends_with_its_code_and_leaves_no_part_of_a_file(tmp_path: Path) -> None:
    """Each command that writes a file; its folder has one block left, and the one in it, `full`, none."""
    data, disk = tmp_path / "data", tmp_path / "disk"
    (data / "recordings").mkdir(parents=True)
    disk.mkdir()
    recording = str(shutil.copy(STORED / f"{RUN}.mcap", data / "recordings"))
    (data / "journal.jsonl").write_text((STORED / "journal.jsonl").read_text() * 20)
    commands = [
        ["audit", "export", "--out", "journal.csv", "--data", str(data)],
        ["support", "--out", "help.zip", "--data", str(data)],
        ["export", recording, "--format", "csv", "--out", "run.csv"],
        ["export", recording, "--format", "mat", "--out", "run.mat"],
        ["report", recording, "--out", "report.html"],
        ["study", "paper", "--out", "full"],
        ["token", "add", "Ada", "--role", "viewer", "--data", "full"],
        ["calibrate", "tare", "--tool", "simulated", "--yes", "--into", "full"],
        ["run", "trapezoid_4hz", "--tissue", "liver", "--cycles", "1", "--record", "run.mcap"],
        ["calibrate", "tare", "--tool", "simulated", "--yes", "--into", "."],
    ]
    within = ["unshare", "-m", "sh", "-c", FULL_DISK, str(disk)]
    for words, (code, _, error) in zip(commands, called(tmp_path, commands, within), strict=True):
        assert code == 6, (words, error)
        assert "No space left on device" in error.replace("\n", " "), (words, error)
    left = set((tmp_path / "disk.left").read_text().split()) - {"./filler", "./full/filler"}
    assert left == {f"./simulated-{date.today()}.toml"}, "a tool file without its plot is whole"


def test_a_mistyped_folder_is_told_and_never_made(tmp_path: Path) -> None:
    commands = [
        [*words, "--data", MISTYPED]
        for words in (
            ["audit", "verify"],
            ["audit", "export"],
            ["token", "list"],
            ["token", "revoke", "Ada"],
            ["token", "add", "Ada", "--role", "viewer"],
            ["replay", str(STORED / f"{RUN}.mcap"), "--serve"],
            ["export", RUN, "--format", "csv"],
            ["report", RUN],
            ["index", "--rebuild"],
            ["index"],
            ["support", "--out", "help.zip"],
        )
    ]
    (tmp_path / "settings.toml").write_text(f'data_folder = "{MISTYPED}"\n')
    commands.append(["audit", "verify", "--config", "settings.toml"])
    for words, (code, out, error) in zip(commands, called(tmp_path, commands, []), strict=True):
        assert code == (0 if words[0] == "index" and "--rebuild" not in words else 2), (words, error)
        assert "no/such" in error.replace("\n", ""), (words, out)
        assert not (tmp_path / "no").exists(), words


def test_a_replay_is_shown_from_a_copy_that_nobody_can_write_to_and_asks_for_its_tokens(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    token = tokens.add_token(data, "Ada", Role.VIEWER, None)
    recording = str(shutil.copy(STORED / f"{RUN}.mcap", data))
    within = ("unshare", "-m", "sh", "-c", READ_ONLY, str(data))
    with Service("replay", recording, "--serve", data=data, within=within) as service:
        assert service.http.get("/api/recordings").status_code == 401
        answer = service.http.get("/api/recordings", headers={"Authorization": f"Bearer {token}"})
        assert answer.status_code == 200
        used = service.http.get("/api/system", headers={"Authorization": f"Bearer {token}"}).json()["data_folder"]
    assert not Path(used).exists()
    assert {path.name for path in data.iterdir()} == {f"{RUN}.mcap", tokens.TOKEN_FILE}


def test_own_names_are_those_of_the_data_folder_in_each_command(tmp_path: Path) -> None:
    (tmp_path / "d/tools").mkdir(parents=True)
    text = (CONFIG_DIR / "tools/simulated.toml").read_text()
    (tmp_path / "d/tools/mine.toml").write_text(text.replace('name = "simulated"', 'name = "mine"'))
    words = ["calibrate", "tare", "--tool", "mine", "--yes", "--into", "/proc"]
    (without, _, says), (code, _, error) = called(tmp_path, [words, [*words, "--data", "d"]], [])
    assert (without, code) == (2, 2)
    assert "There is no tool 'mine'" in says
    assert "/proc: no tool file can be written there" in error
    for command in commands_of(get_command(app)):
        options = {name: option for option in command.params for name in option.opts}
        if any("NAME|FILE" in (option.metavar or "") for option in options.values()):
            assert "--data" in options, command.name


def commands_of(command: Any) -> list[Any]:
    below = getattr(command, "commands", {}).values()
    return [command, *(inner for each in below for inner in commands_of(each))]


def test_a_tilde_in_free_text_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/ada")
    given = ["--data=~", "--data", "~", "~/f", "--json", "~/f", "--label", "liver=~/a,~", "--by=Ada,~", "--by", "~/x"]
    expanded = [each.replace("~", "/home/ada") for each in given[:-3]] + given[-3:]
    assert expand_paths(given, get_command(app)) == expanded
    with pytest.raises(ConfigurationError, match="no such home folder"):
        expand_paths(["--data=~nobody-has-this-name"], get_command(app))


@pytest.mark.parametrize("home", ["of the user", "none"])
def test_a_tilde_is_the_home_folder_or_refused(tmp_path: Path, home: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if home == "none":
        monkeypatch.delenv("HOME")
    else:
        monkeypatch.setenv("HOME", str(tmp_path / "home"))
        (tmp_path / "home/d").mkdir(parents=True)
        (tmp_path / "home/settings.toml").write_bytes(b'\xef\xbb\xbfdata_folder = "~/d"\nindex_url = "sqlite:///~/i"\n')
    commands = [
        ["audit", "verify", "--data=~/d"],
        ["audit", "verify", "--data", "~/d"],
        ["audit", "verify", "--config", "~/settings.toml"],
        ["index", "--json", "--config=~/settings.toml"],
        ["replay", "~/d/none.lvm"],
        ["learn", "--label", "liver=~/d/none.lvm", "--out", "~/d/library.toml"],
        ["run", "~/d/none.toml", "--tissue", "liver"],
    ]
    # A user without an entry has no home folder once HOME is not set.
    within = ["setpriv", "--reuid=54321"] if home == "none" else []
    answers = called(tmp_path, commands, within)
    assert not (tmp_path / "~").exists()
    if home == "none":
        assert [code for code, _, _ in answers] == [2] * len(commands), answers
        assert all("there is no such home folder" in error for _, _, error in answers)
        return
    assert [code for code, _, _ in answers] == [0, 0, 0, 0, 3, 3, 2], answers
    assert json.loads(answers[3][1])["where"] == str(tmp_path / "home/i")
    for _, out, error in answers[4:]:
        assert f"{tmp_path}/home/d/none." in (out + error).replace("\n", ""), error
