"""`make bench`: measures what the issue of speed is about, prints a table and writes bench.json.

Figures are ratios to a reference in the same run, or shares of real time. Nothing here passes or fails.
"""

import argparse
import json
import os
import platform
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(1, str(Path(__file__).parents[1]))  # the tests' own helpers

from benchmarks import bank, headless, learning, live, page, record, report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--live-seconds", type=float, default=120.0, help="how long the live service is watched")
    parser.add_argument("--viewers", type=int, default=20, help="viewers connected meanwhile")
    parser.add_argument("--page-minutes", type=float, default=10.0, help="how long the page's memory is watched")
    parser.add_argument("--output", type=Path, default=Path("bench.json"), help="where the figures are written")
    wanted = parser.parse_args()
    parts = {
        "filter bank": bank.measure,
        "headless": headless.measure,
        "recordings": record.measure,
        "report": report.measure,
        "learning": learning.measure,
        "start": live.measure_start,
        f"live, {wanted.viewers} viewers, {wanted.live_seconds:.0f} s": lambda: live.measure(
            wanted.live_seconds, wanted.viewers
        ),
        f"page, {wanted.page_minutes:.3g} min": lambda: page.measure(wanted.page_minutes),
    }
    console, figures = Console(), []
    for title, measure in parts.items():
        with console.status(f"Measuring: {title}"):
            figures += measure()
    table = Table("Figure", "Measured", "Floor", title=f"{os.cpu_count()} cores, {platform.machine()}")
    for figure in figures:
        table.add_row(figure["name"], f"{figure['value']:.4g} {figure['unit']}", figure["floor"])
    console.print(table)
    wanted.output.write_text(json.dumps({"cores": os.cpu_count(), "figures": figures}, indent=2) + "\n")


main()
