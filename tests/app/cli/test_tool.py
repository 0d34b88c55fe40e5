"""`graspwatch tool new`, as somebody with a recording of another program runs it, at a terminal and in a script."""

import os
import pty
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from closings_table import CLOSINGS, write_closings_table

from config.load import load_tool
from config.schema import ToolKind

GRASPWATCH = Path(sys.executable).parent / "graspwatch"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_closings_table(tmp_path / "mine.csv")


def run_new(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    command = [GRASPWATCH, "tool", "new", *map(str, words), "--data", str(folder / "data")]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=folder)


def test_the_device_that_printed_a_recording_can_be_watched_live(recording: Path, tmp_path: Path) -> None:
    said = ("--from", recording, "--force", 4, "--position", 3, "--port", "/dev/ttyACM7")
    refused = run_new(tmp_path, "mine", *said, "--command", 2)
    assert refused.returncode != 0
    assert "A tool on a serial port has no motor command" in refused.stderr
    done = run_new(tmp_path, "mine", *said)
    assert done.returncode == 0, done.stderr
    assert "Watch it live: graspwatch serve --tool mine" in done.stdout
    tool = load_tool("mine", tmp_path / "data")
    assert tool.serial is not None
    assert (tool.kind, tool.serial.port, tool.has_motor) == (ToolKind.SERIAL, "/dev/ttyACM7", False)


def test_a_recording_becomes_a_tool_that_finds_its_grasps_and_forces(recording: Path, tmp_path: Path) -> None:
    said = ("--force", 4, "--position", 3, "--newton", 0.01, "--millimetre", 0.125)
    done = run_new(tmp_path, "mine", "--from", recording, *said)
    assert done.returncode == 0, done.stderr
    assert "Column 1 holds the times, in ms: 500 samples a second" in done.stdout
    assert f"{CLOSINGS} grasps found" in done.stdout
    peaks = [float(found) for found in re.findall(r"([\d.]+) N ", done.stdout)]
    assert peaks == pytest.approx([3.0] * 5, abs=0.05)
    assert [float(found) for found in re.findall(r"([\d.]+) mm ", done.stdout)] == pytest.approx([5.0] * 5, abs=0.1)
    tool = load_tool("mine", tmp_path / "data")
    assert tool.hand_driven is not None
    replayed = subprocess.run(
        [GRASPWATCH, "replay", recording, "--tool", "mine", "--data", tmp_path / "data"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert replayed.returncode == 0, replayed.stderr
    assert replayed.stdout.count("3.0") >= CLOSINGS


def test_at_a_terminal_it_asks(recording: Path, tmp_path: Path) -> None:
    theirs, ours = pty.openpty()
    os.write(theirs, b"4\n3\n0\n0.01\n0.125\n")
    said = []
    threading.Thread(target=lambda: said.extend(iter(lambda: os.read(theirs, 4096), b"")), daemon=True).start()
    command = [GRASPWATCH, "tool", "new", "mine", "--from", recording, "--data", tmp_path / "data"]
    done = subprocess.run(command, stdin=ours, stdout=subprocess.PIPE, stderr=ours, text=True, timeout=60)
    assert done.returncode == 0, b"".join(said).decode()
    assert f"{CLOSINGS} grasps found" in done.stdout
    asked = b"".join(said).decode()
    assert "Which column is the force sensor?" in asked
    assert "assumed" not in asked


def test_what_is_not_known_is_assumed_and_told(recording: Path, tmp_path: Path) -> None:
    done = run_new(tmp_path, "mine", "--from", recording, "--force", 4, "--position", 3)
    assert done.returncode == 0, done.stderr
    assert "The newtons are assumed" in done.stderr
    scale = load_tool("mine", tmp_path / "data").calibration.jaw_force_scale
    assert (scale.measured, scale.source) == (False, "assumed: one newton a unit")


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        ((), 2, "Nobody is at a terminal to answer: Which column is the force sensor?"),
        (("--force", 2, "--position", 3), 2, "column 2 holds no numbers; there is 1, 3, 4, 5"),
        (("--force", 9, "--position", 3), 2, "column 9 holds no numbers"),
        (("--force", 5, "--position", 3), 2, "column 5 does not change"),
        (("--force", 3, "--position", 3), 2, "force and position are the same column"),
        (
            ("--force", 4, "--position", 3, "--millimetre", 1e6),
            2,
            "Column 4 as the force and column 3 as the position make no plausible tool. Choose other columns",
        ),
    ],
)
def test_what_cannot_be_is_one_message(recording: Path, tmp_path: Path, words, code: int, expected: str) -> None:
    done = run_new(tmp_path, "mine", "--from", recording, *words)
    assert done.returncode == code
    assert expected in " ".join(done.stderr.split())
    assert not (tmp_path / "data/tools/mine.toml").exists()


def test_other_wrong_input_is_one_message_too(recording: Path, tmp_path: Path) -> None:
    assert "is a tool 'simulated' already" in run_new(tmp_path, "simulated", "--from", recording).stderr
    assert "there is no such file" in run_new(tmp_path, "mine", "--from", tmp_path / "nothing.csv").stderr
    timeless = tmp_path / "timeless.csv"
    timeless.write_text(
        "".join(f"{line.split(',')[2]},{line.split(',')[3]}\n" for line in recording.read_text().splitlines())
    )
    refused = run_new(tmp_path, "mine", "--from", timeless, "--force", 2, "--position", 1)
    assert "Say how many samples a second there are" in refused.stderr
    done = run_new(tmp_path, "mine", "--from", timeless, "--force", 2, "--position", 1, "--rate", 500)
    assert f"{CLOSINGS} grasps found" in done.stdout, done.stderr
