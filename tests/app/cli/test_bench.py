"""`graspwatch bench --jitter`: three ways to ask, on an idle and a busy machine, and what was granted."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

GRASPWATCH = Path(sys.executable).parent / "graspwatch"


def bench(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([GRASPWATCH, "bench", *words], capture_output=True, text=True, timeout=120)


@pytest.mark.long
def test_it_measures_each_way_on_an_idle_and_a_busy_machine() -> None:
    done = bench("--jitter", "--seconds", "1", "--json")
    measured = json.loads(done.stdout)["measured"]
    assert [(each["machine"], each["asked for"]) for each in measured] == [
        (machine, ask) for machine in ("idle", "busy") for ask in ("nothing", "as configured", "everything")
    ]
    for each in measured:
        late = list(each["late_ms"].values())
        assert late == sorted(late)
        assert each["blocks"] == 200 or "samples" in each["ended"]  # without priority a busy machine may be too late
    assert "priority not asked for" in measured[0]["granted"]
    assert "core" in measured[2]["granted"]


def test_it_asks_what_to_measure() -> None:
    done = bench()
    assert done.returncode == 2
    assert "--jitter" in done.stderr
