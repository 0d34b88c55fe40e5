"""Reaction times that tests have measured, kept for docs/safety.md where they are asked for."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path


@dataclass
class Reaction:
    fault: str
    moment: str
    measured_ms: float
    floor_ms: float
    test: str


class Reactions:
    """What one test measured."""

    def __init__(self, test: str, path: Path | None) -> None:
        self._test, self._path = test, path

    def add(self, fault: str, moment: str, measured_ms: float, floor_ms: float) -> None:
        if self._path:
            reaction = Reaction(str(fault), str(moment), measured_ms, floor_ms, self._test)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(reaction)) + "\n")
