"""How much faster than real time the headless program goes, whole processes not counted."""

import os
import statistics
import tempfile
import time
from pathlib import Path

from simulation import joined, simulate_raw, write_lvm

from acquisition.recordings.recording import RecordingSource
from app.analysis.headless import replay_recording, run_protocol
from app.recordings.mcap_writer import RecordingContext
from config.load import load_grasp_protocol, load_library, load_settings, load_tool

ROUNDS = 3


def measure() -> list[dict]:
    settings, library, tool = load_settings(), load_library("porcine"), load_tool("simulated")
    protocol = load_grasp_protocol("trapezoid_2hz")

    def run() -> float:
        report = run_protocol(
            tool,
            library,
            settings,
            protocol,
            "liver",
            cycles=10,
            seed=1,
            real_time=False,
            recording_path=None,
            progress=lambda _: None,
        )
        return report.samples / report.rate_hz

    figures = [figure("run on the virtual clock", faster(run), "at least 10")]
    rig = load_tool("smart_tool_2013")
    for path in recordings():
        speed = faster(lambda path=path: replay(path, rig, library, settings))
        figures.append(figure(f"replay of {path.name}", speed, "at least 50"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "simulated.lvm"
        write_lvm(path, joined(simulate_raw("liver", "trapezoid_2hz", seed=1, cycles=10)))
        figures.append(
            figure("replay of a simulated .lvm", faster(lambda: replay(path, rig, library, settings)), "at least 50")
        )
    return figures


def recordings() -> list[Path]:
    folder = Path(os.environ.get("GRASPWATCH_RECORDINGS", Path(__file__).parents[3] / "shared" / "recordings"))
    return sorted(folder.glob("liver*.lvm.gz"))


def replay(path, rig, library, settings) -> float:
    report = replay_recording(RecordingSource(path, rig), RecordingContext(rig, library, settings), lambda _: None)
    return report.samples / report.rate_hz


def faster(work) -> float:
    """Median over some rounds of simulated seconds a second."""
    work()
    ratios = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        ratios.append(work() / (time.perf_counter() - begin))
    return statistics.median(ratios)


def figure(name: str, value: float, floor: str) -> dict:
    return {"name": name, "value": value, "unit": "× real time", "floor": floor}
