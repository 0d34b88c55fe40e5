"""Record measured reaction times and outcomes of tests for docs/safety.md, if `--reactions` names a file."""

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
    """Recorder of one test's reaction times and outcomes."""

    def __init__(self, test: str, path: Path | None) -> None:
        self._test, self._path = test, path

    def add(self, fault: str, moment: str, measured_ms: float, floor_ms: float) -> None:
        self._note(asdict(Reaction(str(fault), str(moment), measured_ms, floor_ms, self._test)))

    def outcome(self, passed: bool) -> None:
        """Record the outcome of one case of the test."""
        self._note({"test": self._test, "passed": passed})

    def _note(self, found: dict[str, Any]) -> None:
        if self._path:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(found) + "\n")
