"""How long a report of 500 grasps takes, from files to a written page, and how large it is."""

import tempfile
import time
from pathlib import Path

from simulation import joined, simulate_raw, write_lvm

from app.analysis.report.page import render_report_page
from app.analysis.report.report import analyze_recordings
from config.atomic_write import write_atomically
from config.load import load_library, load_settings, load_tool

GRASPS = 500


def measure() -> list[dict]:
    settings, library, tool = load_settings(), load_library("porcine"), load_tool("simulated")
    cycles = GRASPS // len(library.tissues)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = {
            write_lvm(folder / f"{tissue}.lvm", joined(simulate_raw(tissue, seed=seed, cycles=cycles))): tissue
            for seed, tissue in enumerate(library.tissues)
        }
        warm_up = write_lvm(folder / "warm-up.lvm", joined(simulate_raw("liver", cycles=1)))
        analyze_recordings([warm_up], tool, library, settings, {}, lambda _: None)
        begin = time.perf_counter()
        report = analyze_recordings([*files], tool, library, settings, files, lambda _: None)
        read_s = time.perf_counter() - begin
        write_atomically(folder / "report.html", render_report_page(report, lambda _: None))
        whole_s = time.perf_counter() - begin
        size_mb = (folder / "report.html").stat().st_size / 1e6
    assert len(report.grasps) == GRASPS
    return [
        {"name": f"report of {GRASPS} grasps", "value": whole_s, "unit": "s", "floor": ""},
        {"name": "of it, reading and estimating", "value": read_s, "unit": "s", "floor": ""},
        {"name": "its page", "value": size_mb, "unit": "MB", "floor": "at most 15"},
    ]
