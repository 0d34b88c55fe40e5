"""`graspwatch check` and `calibrate` against a board in another process: tissue in its jaws, killed, already in use."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from boards import HAS_DRIVER, ServedBoard
from service import PROGRAM, Service, until

pytestmark = [pytest.mark.alone, pytest.mark.skipif(HAS_DRIVER, reason="the driver of a real board is installed")]
ZERO_MS = 500.0  # a person at the bench waits beside the switch


@pytest.fixture
def board(tmp_path: Path) -> Iterator[ServedBoard]:
    with ServedBoard(tmp_path, tissue="liver") as served:
        yield served


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([PROGRAM, *words], capture_output=True, text=True, timeout=90)


def test_a_calibration_with_tissue_in_the_jaws_is_refused_and_ends_at_zero(board: ServedBoard, tmp_path: Path) -> None:
    refused = run("calibrate", "stretch", "--tool", board.tool_file, "--yes")
    assert refused.returncode == 8, refused.stderr
    assert "something between the jaws yields" in refused.stderr
    assert board.peak_force_n > 0.3, "it did close"
    assert board.output_v == 0.0
    assert [path.name for path in tmp_path.glob("*.toml")] == [board.tool_file.name]


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_whoever_ends_it_in_motion_leaves_the_motor_at_zero(board: ServedBoard, how: signal.Signals) -> None:
    program = subprocess.Popen(
        [PROGRAM, "calibrate", "stretch", "--tool", board.tool_file, "--yes"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a test in the background may ignore it
    )
    until(lambda: board.output_v > 0.1)
    struck_ns = time.monotonic_ns()
    os.kill(program.pid, how)
    assert board.zero_after_ms(struck_ns) < ZERO_MS
    program.wait(10)


def test_two_programs_on_one_board_are_told_so(board: ServedBoard) -> None:
    with Service("serve", "--tool", str(board.tool_file)) as service:
        for words in (("check",), ("calibrate", "tare", "--yes")):
            refused = run(*words, "--tool", board.tool_file)
            assert refused.returncode != 0
            assert "Another program uses Dev1" in refused.stdout + refused.stderr
        until(lambda: service.http.get("/api/health").status_code == 200)
        assert service.conditions()["acquisition"] == "running"
