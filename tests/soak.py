"""`make soak`: random faults at random moments of grasps for an hour, on a board that outlives the service.

After each: the motor is at zero in time where it has to be, nothing moves until the fault is acknowledged, no tissue is
named wrong, and the force stayed under the lowest injury threshold. Ends with 1 at a violation.
"""

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(1, str(Path(__file__).parent))  # the tests' own helpers

from boards import ServedBoard
from service import Service, until

from acquisition.simulation.faults import SensorFault
from config.load import load_library

TISSUE = "bladder"
LONG = {"protocol": "trapezoid_2hz", "cycles": 200}
SABOTEUR = Path(__file__).parent / "faults/live/saboteur"
ZEROING = {
    "acquisition killed": ("acquisition", signal.SIGKILL),
    "acquisition stopped": ("acquisition", signal.SIGSTOP),
    "acquisition fails": ("acquisition", signal.SIGUSR1),
}
OTHERS = {
    f"{worker} {how}": (worker, number)
    for worker in ("estimator", "recorder", "guard")
    for how, number in (("killed", signal.SIGKILL), ("fails", signal.SIGUSR1))
}
SENSORS = [
    fault for fault in SensorFault
    if fault not in (SensorFault.STRAIN_SPIKE, SensorFault.ENCODER_SLIPS, SensorFault.ENCODER_REVERSED)
]  # fmt: skip
WORKER_MS, LIVE_SIGNAL_MS, ENCODER_MS = 100.0, 25.0, 1500.0
"""A lost signal takes 15 ms on the board's clock; the rest is for TCP and a machine that does other things."""


class Soak:
    """One service after another, struck until the time is over."""

    def __init__(self, seed: int, board: ServedBoard) -> None:
        self._chance, self._board = random.Random(seed), board
        self.struck: Counter[str] = Counter()
        self.worst_ms: Counter[str] = Counter()
        self.violations: list[str] = []

    def check(self, holds: bool, text: str) -> None:
        if not holds:
            self.violations.append(text)
            print(f"VIOLATION: {text}", file=sys.stderr, flush=True)

    def serve(self, until_s: float) -> None:
        """One service for a few faults, since a worker may die only three times a minute."""
        with Service("serve", "--tool", str(self._board.tool_file)) as service:
            until(lambda: service.http.get("/api/health").json()["workers"]["guard"] == "running")
            for _ in range(3):
                if time.monotonic() < until_s:
                    self.strike(service)
            labels = [grasp["label"] for run in service.http.get("/api/runs").json()
                      for grasp in service.http.get(f"/api/runs/{run['id']}/grasps").json()]  # fmt: skip
            self.check(set(labels) <= {TISSUE, "undecided", "unknown"}, f"named wrong: {set(labels)}")
            lowest_n = load_library("porcine").lowest_threshold_n
            peak_n = self._board.peak_force_n
            self.check(peak_n < lowest_n, f"the force came to {peak_n:.2f} N; the threshold is {lowest_n:.2f} N")
            begin_s = time.monotonic()
            service.end()
            self.check(time.monotonic() - begin_s < 2.5, "SIGTERM took longer than 2 s")
            self.check(self._board.output_v == 0.0, "the motor is driven after SIGTERM")

    def strike(self, service: Service) -> None:
        run = service.run(**LONG)
        self._board.wait_for_force()
        time.sleep(self._chance.uniform(0.0, 2.0))
        kinds: list[Callable[[Service, dict], None]] = [self._zeroing, self._other, self._sensor, self._stop]
        self._chance.choice(kinds)(service, run)

    def _zeroing(self, service: Service, run: dict) -> None:
        what = self._chance.choice(list(ZEROING))
        worker, number = ZEROING[what]
        pid, since_ns = service.worker(worker), time.monotonic_ns()
        os.kill(pid, number)
        self._expect_zero(what, since_ns, WORKER_MS)
        self._recover(service, run, pid)

    def _sensor(self, service: Service, run: dict) -> None:
        fault = self._chance.choice(SENSORS)
        self._board.wait_for_force()
        since_ns = self._board.break_now(fault)
        self._expect_zero(fault, since_ns, ENCODER_MS if fault is SensorFault.ENCODER_STUCK else LIVE_SIGNAL_MS)
        self._board.tell("mend")
        self._recover(service, run, None)

    def _other(self, service: Service, run: dict) -> None:
        what = self._chance.choice(list(OTHERS))
        worker, number = OTHERS[what]
        os.kill(service.worker(worker), number)
        self.struck[what] += 1
        time.sleep(1.0)
        state = service.http.get(f"/api/runs/{run['id']}").json()["state"]
        self.check(state == "running", f"{what}: the run is {state}")
        self._halt(service)

    def _stop(self, service: Service, run: dict) -> None:
        since_ns = time.monotonic_ns()
        service.http.post("/api/stop")
        self._expect_zero("STOP", since_ns, 500.0)

    def _expect_zero(self, what: str, since_ns: int, allowed_ms: float) -> None:
        took_ms = self._board.zero_after_ms(since_ns)
        self.struck[what] += 1
        self.worst_ms[what] = max(self.worst_ms[what], took_ms)
        self.check(took_ms <= allowed_ms, f"{what}: zero after {took_ms:.0f} ms, allowed are {allowed_ms:.0f} ms")

    def _recover(self, service: Service, run: dict, pid: int | None) -> None:
        state = service.finished(run["id"])["state"]
        self.check(state == "failed", f"the run is {state} after a fault")
        until(lambda: (pid is None or not os.path.exists(f"/proc/{pid}")) and service.ready(), 60.0)
        refused = service.http.post("/api/runs", json=LONG).status_code
        self.check(refused == 409, f"a start with a latched fault was answered {refused}")
        self.check(self._board.output_v == 0.0, "the motor is driven after a fault")
        service.acknowledge_fault()

    def _halt(self, service: Service) -> None:
        service.http.post("/api/stop")
        self.check(self._board.output_v == 0.0, "the motor is driven after STOP")
        until(service.ready, 60.0)

    def table(self) -> Table:
        table = Table("fault", "times", "longest reaction")
        for what, count in sorted(self.struck.items()):
            table.add_row(what, str(count), f"{self.worst_ms[what]:.0f} ms" if what in self.worst_ms else "")
        return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    os.environ["PYTHONPATH"] = str(SABOTEUR)
    until_s = time.monotonic() + 60.0 * asked.minutes
    with tempfile.TemporaryDirectory() as folder, ServedBoard(Path(folder), TISSUE) as board:
        soak = Soak(asked.seed, board)
        while time.monotonic() < until_s:
            soak.serve(until_s)
            print(f"{soak.struck.total()} faults, {len(soak.violations)} violations", flush=True)
    Console().print(soak.table())
    sys.exit(1 if soak.violations else 0)


if __name__ == "__main__":
    main()
