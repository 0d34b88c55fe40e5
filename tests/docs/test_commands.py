"""What the documentation tells one to type, typed: every `sh` block of a page, in order, in one shell, in one folder.

`console` blocks are for the machine (make, sudo, docker), and not for a test. RECORDING, RUN and the like stand for the
reader's own: files of such names are put into the folder, RUN is the newest recording there. A `python` block with a
title is saved under that name. The service gets a free port instead of 8000, which may be in use on this machine.
"""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from certificates import self_signed
from simulation import joined, simulate_raw, write_lvm

CHECKOUT = Path(__file__).parents[2]
PROGRAMS = Path(sys.executable).parent
NEWEST = '$(basename "$(ls graspwatch-data/recordings/*.mcap | tail -n 1)" .mcap)'
HELD = {
    "RECORDING": ("liver", 3),
    "liver": ("liver", 3),
    "liver1": ("liver", 4),
    "liver4Hz1": ("liver", 3),
    "bladder": ("bladder", 3),
    "bladder1": ("bladder", 3),
    "bladder2": ("bladder", 4),
    "another": ("bladder", 3),
    "a": ("liver", 3),
    "b": ("liver", 3),
    "c": ("bladder", 3),
}
"""What each of the reader's files holds, and the seed of its specimen."""
LONG_PAGES = ("README.md", "docs/tutorial.md", "docs/operating.md", "docs/recordings.md", "docs/learning.md")
PAGES = [
    "docs/programs.md",
    "docs/foxglove.md",
    "docs/people.md",
    *(pytest.param(page, marks=pytest.mark.long) for page in LONG_PAGES),
]
HARDWARE = "docs/hardware.md"  # needs answers: tests/end_to_end/test_hardware_page.py
PROSE = {"docs/deploying.md", "CONTRIBUTING.md"}  # only what needs root, Docker or make


def blocks(page: str) -> list[tuple[str, str, str]]:
    """Language, title and content of each fenced block."""
    text = (CHECKOUT / page).read_text(encoding="utf-8")
    found = re.findall(r'^ *```(\w*)(?: title="([^"]+)")?\n(.*?)^ *```', text, re.DOTALL | re.MULTILINE)
    return [(language, title, content) for language, title, content in found]


def free_port() -> int:
    with socket.create_server(("", 0)) as listener:
        return listener.getsockname()[1]


def stage(folder: Path, port: int) -> dict[str, str]:
    """Everything that a reader would have; returns the environment of his shell."""
    programs = folder / "programs"
    programs.mkdir()
    serving = f'"{sys.executable}" "{Path(__file__).with_name("serving.py")}" "{folder}"'
    (programs / "graspwatch").write_text(
        f'#!/bin/sh\ncase " $* " in\n'
        f'*" serve "*|*" --serve "*) exec {serving} "{PROGRAMS}/graspwatch" "$@" --port {port} ;;\n'
        f'*" support "*) exec "{PROGRAMS}/graspwatch" "$@" --url http://localhost:{port} ;;\n'
        f'*) exec "{PROGRAMS}/graspwatch" "$@" ;;\nesac\n'
    )
    (programs / "graspwatch").chmod(0o755)
    here = folder / "here"
    self_signed(here)
    grasps = {held: joined(simulate_raw(held[0], seed=held[1], cycles=12)) for held in set(HELD.values())}
    for name, held in HELD.items():
        write_lvm(here / f"{name}.lvm.gz", grasps[held])
    nothing = joined(simulate_raw("liver", "reference_grasp", seed=3, cycles=5, empty=True))
    for name in ("empty", "empty_of_that_day"):
        write_lvm(here / f"{name}.lvm.gz", nothing)
    return {**os.environ, "PATH": f"{programs}:{PROGRAMS}:{os.environ['PATH']}", "FORCE_COLOR": ""}


@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_works(page: str, tmp_path: Path) -> None:
    port = free_port()
    environment, here = stage(tmp_path, port), tmp_path / "here"
    script = ["set -eu"]
    for language, title, block in blocks(page):
        content = block.replace("localhost:8000", f"localhost:{port}")
        if language == "python" and title:
            (here / title).write_text(content, encoding="utf-8")
        if language == "sh":
            script += [re.sub(r"\bRUN\b", NEWEST, content) if "RUN=" not in content else content]
    commands = "\n".join(script).replace("--tool nidaq", "--tool simulated")  # nobody has a board here
    commands = commands.replace("calibrate tare", "calibrate tare --yes")  # nor sits at a terminal
    try:
        done = subprocess.run(
            ["bash", "-c", commands], cwd=here, env=environment, capture_output=True, text=True, timeout=900
        )
    finally:
        subprocess.run([sys.executable, Path(__file__).with_name("serving.py"), tmp_path], check=False)
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"


def test_every_page_with_commands_is_tried() -> None:
    pages = {"README.md", "CONTRIBUTING.md", *(f"docs/{path.name}" for path in (CHECKOUT / "docs").glob("*.md"))}
    tried = {getattr(each, "values", (each,))[0] for each in PAGES} | {HARDWARE}
    with_commands = {page for page in pages if any(language == "sh" for language, _, _ in blocks(page))}
    assert with_commands == tried
    for page in pages - tried:
        text = (CHECKOUT / page).read_text(encoding="utf-8")
        assert page in PROSE or not re.search(r"^ {4}(?:graspwatch|make|curl) ", text, re.MULTILINE), page
