"""`graspwatch check`, as somebody at the bench runs it: the real program on the simulated board, in real time."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from boards import HAS_DRIVER

GRASPWATCH = Path(sys.executable).parent / "graspwatch"
MOVING = {"motor command read back", "round trip", "encoder direction", "encoder scale"}


def check(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([GRASPWATCH, "check", *words], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("move", [True, False])
def test_it_walks_the_tool_and_ends_with_what_it_found(move):
    done = check("--move" if move else "--no-move", "--json")
    found = {each["check"]: each["outcome"] for each in json.loads(done.stdout)["checks"]}
    clock = found.pop("sample clock")  # of a machine that does other things
    assert done.returncode == (0 if clock == "pass" else 4), done.stderr
    moved = {found.pop(name) for name in MOVING}
    assert moved == ({"pass"} if move and clock == "pass" else {"not done"})
    assert {*found.values()} == {"pass"}


@pytest.mark.skipif(HAS_DRIVER, reason="the driver is installed here")
def test_without_a_driver_it_says_what_to_do_once_and_what_was_not_done():
    done = check("--tool", "nidaq")
    assert done.returncode == 4
    assert done.stdout.count("install NI-DAQmx") == 1
    assert done.stdout.count("mend this first: driver") == 1
    assert "is not ready: driver" in done.stderr
