"""Reaction times that tests have measured, and how the tests ended, kept for docs/safety.md where that is asked for."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any


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
        self._note(asdict(Reaction(str(fault), str(moment), measured_ms, floor_ms, self._test)))

    def outcome(self, passed: bool) -> None:
        """Of one case of the test."""
        self._note({"test": self._test, "passed": passed})

    def _note(self, found: dict[str, Any]) -> None:
        if self._path:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(found) + "\n")
