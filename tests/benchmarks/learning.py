"""How long `graspwatch learn` takes with its report, the start of the program not counted."""

import statistics
import tempfile
import time
from pathlib import Path

from simulation import joined, simulate_raw, write_lvm
from typer.testing import CliRunner

from app.cli.main import app

ROUNDS = 3
TISSUES = ("liver", "small_bowel", "bladder", "gallbladder")


def measure() -> list[dict]:
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["learn", "--tool", "simulated", "--out", f"{folder}/learned.toml"]
        recorded_s = 0.0
        for tissue in TISSUES:
            raw = joined(simulate_raw(tissue, "trapezoid_2hz", seed=1, cycles=20))
            recorded_s += len(raw) / 1000
            arguments += ["--label", f"{tissue}={write_lvm(Path(folder) / f'{tissue}.lvm', raw)}"]
        taken_s = [learn(arguments) for _ in range(ROUNDS + 1)][1:]  # the first one imports and compiles
    name = f"learn seconds, {len(TISSUES)} recordings of {recorded_s / len(TISSUES):.0f} s"
    return [{"name": name, "value": statistics.median(taken_s), "unit": "s", "floor": "at most 10"}]


def learn(arguments: list[str]) -> float:
    begin = time.perf_counter()
    result = CliRunner().invoke(app, arguments)
    if result.exit_code != 0:
        raise RuntimeError(result.output)
    return time.perf_counter() - begin
