"""`make soak`: random faults at random moments of grasps for an hour, on a board that outlives the service.

After each: the motor is at zero in time where it has to be, or the run goes on; nothing moves until a fault is
acknowledged. In the end: no tissue was named wrong and some were named right, the force stayed under the lowest injury
threshold, every recording can be read, and no sample is missing. Ends with 1 at a violation.

`--no-faults` plays runs undisturbed: each must come to its end. `--busy 2` keeps two busy programs beside all that.
"""

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import httpx
import numpy as np
from nidaqmx.error_codes import DAQmxErrors
from rich.console import Console
from rich.table import Table
from websockets.sync.client import connect

sys.path.insert(1, str(Path(__file__).parent))  # the tests' own helpers

from boards import ServedBoard
from sabotage import SABOTEUR, SIGNALS
from service import Service, until

from acquisition.recordings.mcap_reader import McapFile
from acquisition.simulation.faults import SensorFault
from app.recordings.run_reader import read_run
from app.service.workers import display_worker_name
from config.errors import RecordingError
from config.load import load_library
from estimator.decision import NO_ANSWER, NOT_NAMED, UNKNOWN

TISSUE = "bladder"
LOWEST_N = load_library("porcine").lowest_threshold_n
GRASPS = {"protocol": "trapezoid_2hz", "cycles": 200}
UNDISTURBED = {"protocol": "trapezoid_2hz", "cycles": 20}
STRIKES_A_SERVICE = 3  # a worker may die only three times a minute
WORKER_MS, HOG_MS, STOP_MS, SIGTERM_S = 100.0, 2000.0, 500.0, 2.0
SILENT_SERVER_MS = 1200.0  # `server_silence_s`, and 0.2 s
LIVE_SIGNAL_MS, ENCODER_MS = 20.0, 1500.0
"""A lost signal takes 15 ms on the board's clock; the rest is a margin for TCP and other load. A stuck encoder shows at
the next grasp at the latest."""
CLOSED_S = 12.0  # the service gives up on a hanging recorder after ten seconds


class Then(Enum):
    """Required outcome of a strike."""

    FAULT = "zero, latched"
    GOES_ON = "goes on"
    STOPPED = "stopped"
    EITHER = "a fault or none"


@dataclass(frozen=True)
class Strike:
    """A fault. `hit` injects it and returns the time, ns of the monotonic clock; `within_ms` is for the motor."""

    hit: Callable[[Service, ServedBoard], int]
    then: Then
    within_ms: float = 0.0


def worker(name: str, number: int) -> Callable[[Service, ServedBoard], int]:
    def hit(service: Service, board: ServedBoard) -> int:
        pid, now_ns = service.worker(name), time.monotonic_ns()
        os.kill(pid, number)
        return now_ns

    return hit


def tell(*question: object) -> Callable[[Service, ServedBoard], int]:
    return lambda service, board: board.tell(*question)


def crowd(service: Service, board: ServedBoard) -> int:
    """Send good and bad requests for two seconds, beside viewers that never read."""

    def ask(number: int) -> None:
        with httpx.Client(base_url=service.url, timeout=30.0) as client:
            while time.monotonic() < end_s:
                client.get(("/api/protocols", "/api/runs", "/api/nothing", "/api/recordings/../../etc")[number % 4])
                client.post("/api/runs", content=b"{" * number)

    end_s = time.monotonic() + 2.0
    with contextlib.ExitStack() as viewers:
        for _ in range(10):
            viewers.enter_context(connect(service.live_url, max_size=None, max_queue=1, close_timeout=0.1))
        clients = [threading.Thread(target=ask, args=(number,)) for number in range(8)]
        for client in clients:
            client.start()
        for client in clients:
            client.join()
    return 0


@contextlib.contextmanager
def busy(programs: int) -> Iterator[None]:
    """Run so many programs that compute without end."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(programs)]
    try:
        yield
    finally:
        for program in running:
            program.kill()
            program.wait()


def busy_core(service: Service, board: ServedBoard) -> int:
    hog = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    time.sleep(3.0)
    hog.kill()
    hog.wait()
    return 0


def server_held_up(for_s: float) -> Callable[[Service, ServedBoard], int]:
    def hit(service: Service, board: ServedBoard) -> int:
        now_ns = time.monotonic_ns()
        os.kill(service.process.pid, signal.SIGSTOP)
        time.sleep(for_s)
        os.kill(service.process.pid, signal.SIGCONT)
        return now_ns

    return hit


def stop(service: Service, board: ServedBoard) -> int:
    now_ns = time.monotonic_ns()
    service.http.post("/api/stop")
    return now_ns


def strikes() -> dict[str, Strike]:
    """Return all strikes by name."""
    found: dict[str, Strike] = {}
    for how, number in SIGNALS.items():
        within_ms = HOG_MS if how == "memory hog" else WORKER_MS
        found[f"acquisition: {how}"] = Strike(worker("acquisition", number), Then.FAULT, within_ms)
        for name in ("estimator", "recorder", "guard"):
            found[f"{name}: {how}"] = Strike(worker(name, number), Then.GOES_ON)
    fatal = dict.fromkeys(SensorFault, Then.FAULT) | {
        SensorFault.STRAIN_SPIKE: Then.GOES_ON,
        SensorFault.ENCODER_SLIPS: Then.EITHER,
        SensorFault.ENCODER_REVERSED: Then.EITHER,
    }
    late = {SensorFault.ENCODER_STUCK: ENCODER_MS, SensorFault.STRAIN_NOISE: 2 * LIVE_SIGNAL_MS}
    for fault, then in fatal.items():
        found[fault] = Strike(tell("break", fault), then, late.get(fault, LIVE_SIGNAL_MS))
    for code in (DAQmxErrors.SAMPLES_NO_LONGER_AVAILABLE, DAQmxErrors.SAMPLES_NOT_YET_AVAILABLE):
        found[f"board: error {code.value}"] = Strike(tell("fail_next_read", code), Then.FAULT, LIVE_SIGNAL_MS)
    found["board: samples late by 50 ms"] = Strike(tell("hold_samples", 0.05), Then.FAULT, LIVE_SIGNAL_MS)
    found["board: sample clock ends"] = Strike(tell("cut_sample_clock", 1), Then.FAULT, LIVE_SIGNAL_MS)
    for lost_s in (0.05, 2.0):
        found[f"board lost for {lost_s:g} s"] = Strike(tell("be_mute", lost_s), Then.FAULT, lost_s * 1e3 + 1e3)
    return found | {
        "STOP": Strike(stop, Then.STOPPED, STOP_MS),
        "a crowd": Strike(crowd, Then.GOES_ON),
        "a busy core": Strike(busy_core, Then.GOES_ON),
        "server held up for 0.5 s": Strike(server_held_up(0.5), Then.GOES_ON),
        "server held up for 2 s": Strike(server_held_up(2.0), Then.FAULT, SILENT_SERVER_MS),
    }


HANGING = ("hangs", "fills its error output")
"""Ends of the names of strikes after which a worker is silent, and is ended seconds later."""


class Soak:
    """The soak: one service after another, with faults until the time is over."""

    def __init__(self, seed: int, board: ServedBoard) -> None:
        self._chance, self._board = random.Random(seed), board
        self._strikes = strikes()
        self._hung = ""  # worker that the strike before has hung, as messages call it
        self._left: list[str] = []  # of this round: each strike happens once before any repeats
        self.struck: Counter[str] = Counter()
        self.worst_ms: Counter[str] = Counter()
        self.labels: Counter[str] = Counter()
        self.unanswered: Counter[str] = Counter()  # grasps without an answer, by reason
        self.violations: list[str] = []

    def check(self, holds: bool, text: str) -> None:
        if not holds:
            self.violations.append(text)
            print(f"VIOLATION: {text}", file=sys.stderr, flush=True)

    def serve(self, until_s: float) -> None:
        """Run one service with a few faults, and check its recordings and its end."""
        with Service("serve", "--tool", str(self._board.tool_file)) as service:
            for _ in range(STRIKES_A_SERVICE):
                if time.monotonic() < until_s:
                    known = len(self.violations)
                    self._strike(service)
                    if len(self.violations) > known:
                        print(_recent_log(service), file=sys.stderr, flush=True)
            self._judge_recordings(service)
            self.check(self._board.peak_force_n < LOWEST_N, f"the force came to {self._board.peak_force_n:.2f} N")
            begin_s = time.monotonic()
            service.end()
            took_s = time.monotonic() - begin_s
            self.check(took_s < SIGTERM_S, f"SIGTERM took {took_s:.1f} s")
            self.check(self._board.output_v == 0.0, "the motor is driven after SIGTERM")

    def undisturbed(self, until_s: float) -> None:
        """Run one service without faults, and check that every run finishes its protocol."""
        with Service("serve", "--tool", str(self._board.tool_file)) as service:
            while time.monotonic() < until_s:
                run = service.finished(service.run(**UNDISTURBED)["id"], 120.0)
                self.check(run["state"] == "finished", f"the run {run['state']}: {run['why']}")
                self.struck["undisturbed run"] += 1
                if run["state"] == "failed":
                    service.acknowledge_fault()
            self._judge_recordings(service)
            delays = [line for line in service.http.get("/metrics").text.splitlines() if "server_delay" in line]
            print(*(line for line in delays if "bucket" in line or "count" in line), sep="\n", flush=True)

    def _strike(self, service: Service) -> None:
        self._left = self._left or self._chance.sample(sorted(self._strikes), len(self._strikes))
        name = self._left.pop()
        strike = self._strikes[name]
        started = service.http.post("/api/runs", json=GRASPS)
        if started.status_code == 503 and self._hung and self._hung in started.text:
            until(lambda: _is_whole(service), 60.0)  # the worker that was hung before is only ended now
            started = service.http.post("/api/runs", json=GRASPS)
        self.check(started.status_code == 201, f"no start before {name}: {started.text}")
        self._hung = display_worker_name(name.partition(":")[0]) if name.endswith(HANGING) else ""
        if started.status_code != 201:
            return
        run = started.json()
        self._board.wait_for_force()
        time.sleep(self._chance.uniform(0.0, 2.0))
        if strike.within_ms and strike.then is not Then.STOPPED:
            self._board.wait_for_force()  # a fault at rest is detected at rest, without a reaction of the motor
        since_ns = strike.hit(service, self._board)
        self.struck[name] += 1
        if strike.then in (Then.FAULT, Then.STOPPED):
            took_ms = self._board.zero_after_ms(since_ns)
            self.worst_ms[name] = max(self.worst_ms[name], took_ms)
            self.check(took_ms <= strike.within_ms, f"{name}: zero after {took_ms:.0f} ms")
        else:
            time.sleep(2.0)
        now = service.http.get(f"/api/runs/{run['id']}").json()
        wanted = {Then.GOES_ON: "running", Then.STOPPED: "stopped"}.get(strike.then)
        self.check(wanted in (None, now["state"]), f"{name}: the run is {now['state']}: {now['why']}")
        self._board.tell("mend")
        self._recover(service, run, name, strike.then)

    def _recover(self, service: Service, run: dict, name: str, then: Then) -> None:
        if then in (Then.GOES_ON, Then.EITHER):
            service.http.post("/api/stop")
        state = service.finished(run["id"])["state"]
        is_fault = state == "failed"
        self.check(then is Then.EITHER or is_fault is (then is Then.FAULT), f"{name}: in the end the run is {state}")
        try:
            until(lambda: _is_whole(service), 60.0)
        except AssertionError:
            print(
                f"{name}: {service.http.get('/api/health').text}\n{_recent_log(service)}", file=sys.stderr, flush=True
            )
            raise
        self.check(self._board.output_v == 0.0, f"{name}: the motor is driven afterwards")
        if is_fault:
            refused = service.http.post("/api/runs", json=GRASPS).status_code
            self.check(refused == 409, f"{name}: a start with a latched fault was answered {refused}")
            service.acknowledge_fault()

    def _judge_recordings(self, service: Service) -> None:
        folder = service.data / "recordings"
        until(lambda: all(McapFile(path).complete for path in folder.glob("*.mcap")), CLOSED_S)
        for path in sorted(folder.glob("*.mcap")):
            try:
                found = read_run(path)
            except RecordingError as error:
                self.check("before the first second" in str(error), str(error))
                continue
            gaps = int((np.diff(found.samples["tick"]) != 1).sum())
            self.check(gaps == 0, f"{path.name}: {gaps} gaps in its samples")
            self.labels.update(grasp.label for grasp in found.grasps)
            self.unanswered.update(str(grasp.why_invalid) for grasp in found.grasps if grasp.label == NO_ANSWER)
        self.check(set(self.labels) <= {TISSUE, UNKNOWN, *NOT_NAMED}, f"named wrong: {dict(self.labels)}")
        lost = service.http.get("/metrics").text
        self.check("graspwatch_lost_samples_total 0.0" in lost, "samples were lost")

    def table(self) -> Table:
        table = Table("fault", "times", "longest reaction", "allowed")
        for name, count in sorted(self.struck.items()):
            if name in self.worst_ms:
                timed = (f"{self.worst_ms[name]:.0f} ms", f"{self._strikes[name].within_ms:.0f} ms")
            else:
                timed = ("goes on", "")
            table.add_row(name, str(count), *timed)
        return table


def _is_whole(service: Service) -> bool:
    return service.ready() and set(service.conditions().values()) == {"running"}


def _recent_log(service: Service) -> str:
    """Return the last lines of the service's log, to explain a violation."""
    return "\n".join((service.data / "logs" / "graspwatch.jsonl").read_text(encoding="utf-8").splitlines()[-25:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--busy", type=int, default=0, help="busy programs beside it")
    parser.add_argument("--no-faults", action="store_true", help="only runs, undisturbed")
    asked = parser.parse_args()
    os.environ["PYTHONPATH"] = str(SABOTEUR)
    until_s = time.monotonic() + 60.0 * asked.minutes
    print(f"seed {asked.seed}", flush=True)
    with tempfile.TemporaryDirectory() as folder, ServedBoard(Path(folder), TISSUE) as board, busy(asked.busy):
        soak = Soak(asked.seed, board)
        while time.monotonic() < until_s:
            (soak.undisturbed if asked.no_faults else soak.serve)(until_s)
            print(f"{soak.struck.total()} faults, {len(soak.violations)} violations", flush=True)
    soak.check(soak.labels[TISSUE] > 0, f"nothing was named right: {dict(soak.labels)}")
    Console().print(soak.table())
    print(f"grasps: {dict(soak.labels)}, {dict(soak.unanswered)}; {len(soak.violations)} violations")
    sys.exit(1 if soak.violations else 0)


if __name__ == "__main__":
    main()
