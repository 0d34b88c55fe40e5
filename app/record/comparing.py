"""Whether a replay gives the estimates that were recorded, and what was different if it does not."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquisition.recordings import layout
from acquisition.recordings.container import Container, Rows
from app.record.run_file import Rig
from config.errors import RecordingError
from estimator.recorded import estimate_columns

PARTS_THAT_COUNT = ("conditioning", "identification", "limiter", "warnings")  # of the settings, for estimates
WORDS = {layout.TOOL: "tool", layout.LIBRARY: "library", layout.SETTINGS: "settings", layout.VERSIONS: "version of"}
SHOWN = 12  # differences of the configuration


@dataclass(slots=True)
class Comparison:
    """What came of it. Only samples of the run are compared: those from before it began had a past that is not kept."""

    run_id: str
    differences: list[str]
    compared: int = 0
    unequal: int = 0
    first_unequal: str | None = None

    def document(self) -> dict[str, Any]:
        return {
            "run": self.run_id,
            "compared_samples": self.compared,
            "unequal_samples": self.unequal,
            "bit_for_bit": self.compared > 0 and not self.unequal,
            "first_unequal": self.first_unequal,
            "differences": self.differences,
        }

    def text(self) -> str:
        """One line for people, and the differences."""
        if not self.compared:
            said = f"Run {self.run_id}: none of its estimates could be compared."
        elif self.unequal:
            said = (
                f"Run {self.run_id}: {self.unequal} of {self.compared} estimates differ from those recorded, "
                f"first {self.first_unequal}."
            )
        else:
            said = f"Run {self.run_id}: all {self.compared} estimates are bit for bit those recorded."
        what = "; ".join(self.differences)
        return f"{said} What differs: {what}." if what else said


class Comparing:
    """Give it a replay's estimates in their order."""

    def __init__(self, container: Container, rig: Rig, first_tick: int) -> None:
        """`rig`: what is replayed with; `first_tick`: what the replay's ticks count from."""
        about = container.about
        self._first_tick, self._begins = first_tick, int(about["run_first_tick"])
        self._tissues = list(rig.library.tissues)
        self.result = Comparison(about["run_id"], differences(container, rig))
        self._pieces = _estimates(container)
        self._recorded: Rows | None = None
        self._at = 0
        if about.get("continues"):
            self.result.differences.append("the file continues another one, without which it cannot be equal")

    def take(self, estimates: np.ndarray) -> None:
        """Estimates of consecutive samples."""
        ticks = estimates["tick"] + self._first_tick
        columns = estimate_columns(estimates, self._tissues)
        own = ticks >= self._begins
        at = int(np.argmax(own)) if own.any() else len(ticks)
        while at < len(ticks) and self._next(int(ticks[at])):
            recorded, begin = self._recorded, self._at
            assert recorded is not None
            count = min(len(ticks) - at, len(recorded) - begin)
            if (recorded.columns["tick"][begin : begin + count] != ticks[at : at + count]).any():
                count = 1
            self._compare(columns, at, recorded, begin, count)
            at += count

    def _next(self, tick: int) -> bool:
        """Go to this tick in the recorded estimates; False where there are none for it."""
        while self._recorded is None or int(self._recorded.columns["tick"][-1]) < tick:
            self._recorded = next(self._pieces, None)
            if self._recorded is None:
                return False
        self._at = int(np.searchsorted(self._recorded.columns["tick"], tick))
        return int(self._recorded.columns["tick"][self._at]) == tick

    def _compare(self, columns: dict[str, np.ndarray], at: int, recorded: Rows, begin: int, count: int) -> None:
        unequal = np.zeros(count, bool)
        names: list[str] = []
        for path, values in columns.items():
            if path == "tick" or path not in recorded.columns:
                continue
            before, now = recorded.columns[path][begin : begin + count], values[at : at + count]
            differ = before.view(np.uint64) != np.ascontiguousarray(now).view(np.uint64)
            differ &= ~(np.isnan(before) & np.isnan(now))  # there is one NaN: no value
            if differ.any():
                names.append(path)
                unequal |= differ
        self.result.compared += count
        self.result.unequal += int(np.count_nonzero(unequal))
        if names and self.result.first_unequal is None:
            tick = int(recorded.columns["tick"][begin + int(np.argmax(unequal))])
            self.result.first_unequal = f"{names[0]} at sample {tick - self._begins} of the run"


def _estimates(container: Container) -> Iterator[Rows]:
    for rows in container.read(layout.ESTIMATES):
        assert isinstance(rows, Rows)
        yield rows


def differences(container: Container, rig: Rig) -> list[str]:
    """What differs between a recording's configuration and this one, as far as it matters for estimates.

    Raises:
        RecordingError: the file does not hold its configuration.
    """
    try:
        then = {name: json.loads(container.attachments[name]) for name in rig.attachments()}
    except (KeyError, ValueError) as error:
        raise RecordingError(f"{container.path}: its configuration cannot be read ({error}).") from None
    now = {name: json.loads(content) for name, content in rig.attachments().items()}
    for each in (then, now):
        each[layout.SETTINGS] = {part: each[layout.SETTINGS].get(part) for part in PARTS_THAT_COUNT}
    found = []
    for name, what in WORDS.items():
        found += list(_unlike(what, then[name], now[name]))
    if len(found) > SHOWN:
        found = [*found[:SHOWN], f"and {len(found) - SHOWN} more"]
    return found


def _unlike(place: str, then: Any, now: Any) -> Iterator[str]:
    if isinstance(then, dict) and isinstance(now, dict):
        for key in sorted({*then, *now}):
            yield from _unlike(f"{place} {key}", then.get(key), now.get(key))
    elif then != now:
        yield f"{place}: recorded with {_short(then)}, now {_short(now)}"


def _short(value: Any) -> str:
    text = "nothing" if value is None else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
