"""The compiled bank for four tissues, a strict and a lenient filter for each, against the same bank on filterpy."""

import os
import time
from collections.abc import Callable

# before numpy: on a busy machine OpenBLAS' threads wait for each other in scipy's expm, and filterpy would look slower
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from grasps import conditioned, signals

from config.load import load_grasp_protocol, load_library, load_settings, load_tool
from estimator.baselines.filterpy_reference import ReferenceBank
from estimator.evidence import BankEvidence
from estimator.filter_bank import FilterBank

SAMPLES, BLOCK = 500, 5


def measure() -> list[dict]:
    tool, library, settings = load_tool("simulated"), load_library("porcine"), load_settings()
    samples, _ = conditioned(tool, library, settings, load_grasp_protocol("trapezoid_2hz"), "gallbladder")
    contact, after = signals(samples)
    after = after[:SAMPLES]
    bank = FilterBank.from_tool(tool, library)
    evidence = BankEvidence(bank, library, settings.identification)

    def compiled() -> None:
        bank.start(contact)
        bank.advance(after)

    def with_probabilities() -> None:
        bank.start(contact)
        for i in range(0, len(after), BLOCK):
            bank.advance(after[i : i + BLOCK])
            evidence.probabilities()

    def on_filterpy() -> None:
        bank.start(contact)
        with np.errstate(all="ignore"):  # a filter that diverges overflows
            ReferenceBank(bank).advance(after)

    with_probabilities()
    ours, whole = (best_of(work, 30) / len(after) for work in (compiled, with_probabilities))
    reference = best_of(on_filterpy, 3) / len(after)
    return [
        {"name": "bank, all filters, per sample", "value": ours * 1e6, "unit": "µs", "floor": ""},
        {"name": "per sample with probabilities, blocks of 5", "value": whole * 1e6, "unit": "µs", "floor": ""},
        {"name": "bank on filterpy, per sample", "value": reference * 1e6, "unit": "µs", "floor": ""},
        {"name": "bank against filterpy", "value": reference / ours, "unit": "times", "floor": "at least 300"},
    ]


def best_of(work: Callable[[], None], times: int) -> float:
    """The shortest duration, s: the least disturbed one."""
    durations = []
    for _ in range(times):
        begin = time.perf_counter()
        work()
        durations.append(time.perf_counter() - begin)
    return min(durations)
