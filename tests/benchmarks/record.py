"""Recording, replaying and exchanging runs: what it costs, and how fast it goes."""

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from service import Service, until
from simulation import joined, simulate_raw, write_lvm

from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import RecordingSource
from app.analysis.headless import replay_recording
from app.recordings.exchange.export import export_run
from app.recordings.exchange.export_formats import ExportFormat
from app.recordings.exchange.log_import import import_log
from app.recordings.mcap_writer import RecordingContext
from config.load import load_library, load_settings, load_tool

RUN_S = 60.0


def measure() -> list[dict]:
    with tempfile.TemporaryDirectory() as folder:
        rows = [*_live(Path(folder)), *_files(Path(folder))]
    return [{"name": name, "value": value, "unit": unit, "floor": floor} for name, value, unit, floor in rows]


def _live(folder: Path) -> list[tuple[str, float, str, str]]:
    """A run of a minute under the real recorder; its file is kept as `run.mcap`."""
    with Service("serve") as service:
        recorder = service.worker("recorder")
        idle_s, _ = _busy(recorder, lambda: time.sleep(10.0))
        run = service.run(protocol="trapezoid_2hz", cycles=round(RUN_S / 1.25), tissue="liver")
        busy_s, taken_s = _busy(recorder, lambda: service.finished(run["id"], 2 * RUN_S))
        path = service.data / "recordings" / f"{run['id']}.mcap"
        until(lambda: McapFile(path).complete)
        container = McapFile(path)
        minutes = container.message_counts["/raw"] / 60_000
        path.rename(folder / "run.mcap")
        size_mb = (folder / "run.mcap").stat().st_size / 1e6
    return [
        ("recorder, while a run is recorded", 100 * busy_s / taken_s, "% of a core", "at most 10"),
        ("recorder, between runs", 100 * idle_s / 10.0, "% of a core", ""),
        ("a recording's size", size_mb / minutes, "MB/min", "at most 25"),
    ]


def _busy(pid: int, work: Callable[[], object]) -> tuple[float, float]:
    """Processor seconds that a process takes meanwhile, and how long that is."""

    def processor_s() -> float:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    begin, begin_s = time.monotonic(), processor_s()
    work()
    return processor_s() - begin_s, time.monotonic() - begin


def _files(folder: Path) -> list[tuple[str, float, str, str]]:
    rig = RecordingContext(load_tool("smart_tool_2013"), load_library("porcine"), load_settings())
    log = write_lvm(folder / "log.lvm", joined(simulate_raw("liver", "trapezoid_2hz", seed=1, cycles=40)))
    run = folder / "run.mcap"

    def replay() -> float:
        recording = RecordingSource(run, rig.tool)
        replay_recording(recording, RecordingContext.from_recording(recording.mcap_file), lambda _: None)
        return recording.duration_s

    def take_in() -> float:
        path = import_log(log, folder, rig, None, lambda _: None).path
        duration_s = RecordingSource(path, rig.tool).duration_s
        path.unlink()
        return duration_s

    replay()  # compiles
    rows = []
    for name, work, size in (("replay of an .mcap", replay, run), ("import of an .lvm", take_in, log)):
        begin = time.perf_counter()
        duration_s = work()
        taken_s = time.perf_counter() - begin
        rows.append((f"{name}, as fast as it goes", duration_s / taken_s, "× real time", "at least 50"))
        rows.append((f"{name}, file", size.stat().st_size / 1e6 / taken_s, "MB/s", ""))
    for wanted in ExportFormat:
        begin = time.perf_counter()
        export_run(run, folder / f"out.{wanted.value}", wanted)
        rows.append((f"export of a minute as {wanted.value}", time.perf_counter() - begin, "s", ""))
    return rows
