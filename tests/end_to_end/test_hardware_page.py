"""docs/hardware.md, followed from start to end by somebody without hardware: every command as it stands there."""

import os
import pty
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[2]


def commands() -> str:
    page = (CHECKOUT / "docs/hardware.md").read_text()
    blocks = re.findall(r"^ *```sh\n(.*?)^ *```", page, re.DOTALL | re.MULTILINE)
    assert len(blocks) == 6
    return "\n".join(line.strip() for block in blocks for line in block.splitlines())


@pytest.mark.long
@pytest.mark.timeout(450)
def test_the_first_day_goes_as_the_page_says(tmp_path: Path) -> None:
    (tmp_path / "config").symlink_to(CHECKOUT / "config")
    script = "set -e\n" + commands().replace("config/tools/nidaq.toml", "config/tools/simulated.toml")
    theirs, ours = pty.openpty()
    threading.Thread(target=os.write, args=(theirs, b"y\n" * 100), daemon=True).start()
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.Popen(
        ["bash", "-c", script],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        stdin=ours,
        stdout=subprocess.PIPE,
        stderr=ours,
        text=True,
    )
    said = []
    threading.Thread(target=lambda: said.extend(iter(lambda: os.read(theirs, 4096), b"")), daemon=True).start()
    out, _ = done.communicate(timeout=400)
    assert done.returncode == 0, (out, b"".join(said).decode())
    assert out.count("all is well") == 4
    assert len(list(tmp_path.glob("bench*.toml"))) == 6
