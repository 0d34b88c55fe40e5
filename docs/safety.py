"""Write docs/safety.md from docs/hazards.toml and from the reaction times that the tests have measured."""

import json
import sys
import tomllib
from collections import defaultdict
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
INTRODUCTION = """# What can go wrong, what stops it, and how quickly

Written by `make safety` from [hazards.toml](hazards.toml) and from what the tests measured on the machine that ran
them; neither times nor outcomes are typed. A reaction lasts from the first bad sample, or the strike, until the motor
command output of the simulated board is at zero for good; one named "alarm" until the alarm is on the wire. Sensors and
errors of the board are tried on the board's own clock, without the time that the computer takes to compute, about 1 ms
a block; all others in real time, the board in a process of its own over TCP. Graspwatch is a research instrument:
software alone does not protect a patient. What only hardware can stop stands with each hazard.
"""


def hazards() -> list[dict[str, Any]]:
    return tomllib.loads((HERE / "hazards.toml").read_text(encoding="utf-8"))["hazard"]


def page(told: list[dict[str, Any]]) -> str:
    """The whole page for what the tests told: measured reactions, and which cases passed."""
    reactions = [each for each in told if "fault" in each]
    outcomes: dict[str, list[bool]] = defaultdict(list)
    for each in told:
        if "passed" in each:
            outcomes[each["test"]].append(each["passed"])
    parts = [INTRODUCTION]
    for number, hazard in enumerate(hazards(), 1):
        parts.append(f"## {number}. {hazard['hazard']}\n")
        parts.append(f"- **Causes**: {hazard['causes']}.\n- **What stops it**: {hazard['stops']}.")
        if hazard["hardware"]:
            parts.append(f"- **What only hardware can stop**: {hazard['hardware']}")
        parts.append("- **Shown by**:")
        parts += [f"  - `{test}`: {_outcome(outcomes[test])}" for test in hazard["tests"]]
        parts.append("")
        own = [each for each in reactions if each["fault"].startswith(tuple(hazard["faults"]))]
        if own:
            parts.append(_table(own))
    return "\n".join(parts)


def _outcome(passed: list[bool]) -> str:
    if not passed:
        return "**not run**"
    failed = passed.count(False)
    return f"**{failed} of {len(passed)} failed**" if failed else f"{len(passed)} passed"


def _table(reactions: list[dict[str, Any]]) -> str:
    grouped: dict[tuple[str, str, float], list[float]] = defaultdict(list)
    for each in reactions:
        grouped[each["fault"], each["moment"], each["floor_ms"]].append(each["measured_ms"])
    rows = ["| fault | when | cases | reaction, longest | allowed |", "|---|---|---|---|---|"]
    for (fault, moment, floor_ms), measured_ms in grouped.items():
        rows.append(f"| {fault} | {moment} | {len(measured_ms)} | {max(measured_ms):.0f} ms | {floor_ms:.0f} ms |")
    return "\n".join([*rows, ""])


def main() -> None:
    """Arguments: the file that the tests have written; none: print the tests that show something."""
    if len(sys.argv) == 1:
        print(*sorted({test for hazard in hazards() for test in hazard["tests"]}))
        return
    lines = Path(sys.argv[1]).read_text(encoding="utf-8").splitlines()
    (HERE / "safety.md").write_text(page([json.loads(line) for line in lines]), encoding="utf-8")


if __name__ == "__main__":
    main()
