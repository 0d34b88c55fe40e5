"""`graspwatch token`, and where the service may listen: the real program."""

import json
import os
import subprocess
from pathlib import Path

import pytest
from service import PROGRAM
from simulation import joined, simulate_raw, write_lvm


def graspwatch(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [PROGRAM, *arguments], capture_output=True, text=True, timeout=60, env={**os.environ, "COLUMNS": "300"}
    )
    assert "Traceback" not in done.stderr
    return done


def test_a_token_is_made_shown_once_listed_and_taken_back(tmp_path: Path) -> None:
    made = graspwatch("token", "add", "Ada [x]", "--role", "operator", "--expires", "30", "--data", tmp_path)
    token = made.stdout.strip()
    assert (made.returncode, len(token.split())) == (0, 1)
    listed = graspwatch("token", "list", "--data", tmp_path)
    assert all(word in listed.stdout for word in ("Ada [x]", "operator", "good until"))
    [entry] = json.loads(graspwatch("token", "list", "--json", "--data", tmp_path).stdout)
    assert (entry["name"], entry["revoked_at"]) == ("Ada [x]", None)
    assert token not in listed.stdout + json.dumps(entry)
    assert "sha256" not in entry
    assert graspwatch("token", "revoke", "Ada [x]", "--data", tmp_path).returncode == 0
    assert "revoked" in graspwatch("token", "list", "--data", tmp_path).stdout


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("add", "Ada", "--role", "king"), "viewer"),
        (("add", " ", "--role", "viewer"), "printable"),
        (("revoke", "Eve"), "nobody"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, arguments: tuple[str, ...], says: str) -> None:
    done = graspwatch("token", *arguments, "--data", tmp_path)
    assert done.returncode == 2
    assert says in done.stderr


@pytest.mark.parametrize("command", [("serve",), ("replay", "{recording}", "--serve")])
def test_without_a_good_token_nobody_else_is_let_near_the_tool(tmp_path: Path, command: tuple[str, ...]) -> None:
    recording = write_lvm(tmp_path / "some.lvm", joined(simulate_raw("bladder", cycles=1)))
    graspwatch("token", "add", "Ada", "--role", "admin", "--data", tmp_path)
    graspwatch("token", "revoke", "Ada", "--data", tmp_path)
    arguments = [part.format(recording=recording) for part in command]
    done = graspwatch(*arguments, "--host", "0.0.0.0", "--port", "0", "--data", tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert f"graspwatch token add NAME --role admin --data {tmp_path}" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--tls-cert", "cert.pem"), "go together"),
        (("--tls-key", "cert.pem"), "go together"),
        (("--tls-cert", "cert.pem", "--tls-key", "nowhere.pem"), "no such file"),
        (("--tls-cert", "cert.pem", "--tls-key", "cert.pem"), "PEM"),
    ],
)
def test_a_certificate_that_is_none_stops_the_start(tmp_path: Path, arguments: tuple[str, ...], says: str) -> None:
    (tmp_path / "cert.pem").write_text("rubbish")
    paths = [str(tmp_path / part) if part.endswith(".pem") else part for part in arguments]
    done = graspwatch("serve", *paths, "--port", "0", "--data", tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert says in done.stderr


def test_the_old_admins_file_is_told_what_to_do_instead(tmp_path: Path) -> None:
    (tmp_path / "old.toml").write_text('[server]\nadmin_token_file = "/etc/graspwatch/admin-token"\n')
    done = graspwatch("serve", "--config", tmp_path / "old.toml", "--port", "0", "--data", tmp_path)
    assert done.returncode == 2
    assert "graspwatch token add NAME --role admin" in done.stderr
