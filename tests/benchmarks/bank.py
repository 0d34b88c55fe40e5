"""The compiled bank of four against the same bank on filterpy."""

import time

import numpy as np
from grasps import conditioned, signals

from config.load import load_library, load_protocol, load_settings, load_tool
from estimator.bank import Bank, Contact
from estimator.evidence import Evidence
from estimator.reference import ReferenceBank


def measure() -> list[dict]:
    tool, library, settings = load_tool("simulated"), load_library("porcine"), load_settings()
    samples, _ = conditioned(tool, library, settings, load_protocol("trapezoid_2hz"), "gallbladder")
    force, x, by_force, by_x = (signal[:500] for signal in signals(samples))
    contact = Contact(float(force[0]), float(by_x[0]))
    bank = Bank(tool, library)
    evidence = Evidence(bank, settings.identification)

    def compiled() -> None:
        bank.start(contact)
        bank.advance(force, x, by_force, by_x)

    def with_probabilities() -> None:
        bank.start(contact)
        for i in range(0, len(force), 5):
            bank.advance(force[i : i + 5], x[i : i + 5], by_force[i : i + 5], by_x[i : i + 5])
            evidence.probabilities()

    def on_filterpy() -> None:
        bank.start(contact)
        with np.errstate(all="ignore"):
            ReferenceBank(bank).advance(force, x, by_force, by_x)

    with_probabilities()
    ours, whole = (best_of(work, 30) / len(force) for work in (compiled, with_probabilities))
    reference = best_of(on_filterpy, 3) / len(force)
    return [
        {"name": "bank of four, per sample", "value": ours * 1e6, "unit": "µs", "floor": "aim 2"},
        {"name": "bank on filterpy, per sample", "value": reference * 1e6, "unit": "µs", "floor": ""},
        {"name": "bank against filterpy", "value": reference / ours, "unit": "times", "floor": "at least 150"},
        {"name": "with probabilities, blocks of 5", "value": whole * 1e6, "unit": "µs", "floor": ""},
    ]


def best_of(work, times: int) -> float:
    """The shortest duration, s: the least disturbed one."""
    durations = []
    for _ in range(times):
        begin = time.perf_counter()
        work()
        durations.append(time.perf_counter() - begin)
    return min(durations)
