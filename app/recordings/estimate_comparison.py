"""The class EstimateComparator, which compares a replay's estimates with the recorded ones, and both configurations."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from acquisition.recordings import mcap_layout
from acquisition.recordings.mcap_reader import McapFile, RowBlock
from app.recordings.mcap_writer import RecordingContext
from config.errors import RecordingError
from estimator.estimate_rows import estimate_columns

RELEVANT_SETTINGS = ("conditioning", "identification", "limiter", "warnings")  # those that affect estimates
CONFIGURATION_NAMES = {
    mcap_layout.TOOL_ATTACHMENT: "tool",
    mcap_layout.LIBRARY_ATTACHMENT: "library",
    mcap_layout.SETTINGS_ATTACHMENT: "settings",
    mcap_layout.VERSIONS_METADATA_NAME: "version of",
}
MAX_DIFFERENCES = 12  # of the configuration


@dataclass(slots=True)
class EstimateComparison:
    """Result of a comparison of the run's samples; earlier samples depend on data that are not recorded."""

    run_id: str
    differences: list[str]
    compared_samples: int = 0
    unequal_samples: int = 0
    first_unequal: str | None = None

    def document(self) -> dict[str, Any]:
        return {
            "run": self.run_id,
            "compared_samples": self.compared_samples,
            "unequal_samples": self.unequal_samples,
            "bit_for_bit": self.compared_samples > 0 and not self.unequal_samples,
            "first_unequal": self.first_unequal,
            "differences": self.differences,
        }

    def text(self) -> str:
        """Return one line for people, with the differences."""
        if not self.compared_samples:
            said = f"Run {self.run_id}: none of its estimates could be compared."
        elif self.unequal_samples:
            said = (
                f"Run {self.run_id}: {self.unequal_samples} of {self.compared_samples} estimates differ "
                "from those recorded, "
                f"first {self.first_unequal}."
            )
        else:
            said = f"Run {self.run_id}: all {self.compared_samples} estimates are bit for bit those recorded."
        what = "; ".join(self.differences)
        return f"{said} What differs: {what}." if what else said


class EstimateComparator:
    """Comparator for a replay's estimates, passed in their order."""

    def __init__(self, container: McapFile, recording_context: RecordingContext, first_tick: int) -> None:
        """`recording_context`: configuration of the replay; `first_tick`: recorded tick that is 0 in the replay."""
        about = container.metadata
        self._first_tick, self._run_first_tick = first_tick, int(about["run_first_tick"])
        self._tissues = list(recording_context.library.tissues)
        self.result = EstimateComparison(about["run_id"], find_configuration_differences(container, recording_context))
        self._recorded_pieces = _read_estimates(container)
        self._recorded: RowBlock | None = None
        self._row_index = 0
        if about.get("continues"):
            self.result.differences.append("the file continues another one, without which it cannot be equal")

    def compare(self, estimates: np.ndarray) -> None:
        """Compare the estimates of consecutive samples."""
        ticks = estimates["tick"] + self._first_tick
        columns = estimate_columns(estimates, self._tissues)
        own = ticks >= self._run_first_tick
        at = int(np.argmax(own)) if own.any() else len(ticks)
        while at < len(ticks) and self._seek_tick(int(ticks[at])):
            recorded, begin = self._recorded, self._row_index
            assert recorded is not None
            count = min(len(ticks) - at, len(recorded) - begin)
            if (recorded.columns["tick"][begin : begin + count] != ticks[at : at + count]).any():
                count = 1
            self._compare_rows(columns, at, recorded, begin, count)
            at += count

    def _seek_tick(self, tick: int) -> bool:
        """Go to this tick in the recorded estimates; return False if it has none."""
        while self._recorded is None or int(self._recorded.columns["tick"][-1]) < tick:
            self._recorded = next(self._recorded_pieces, None)
            if self._recorded is None:
                return False
        self._row_index = int(np.searchsorted(self._recorded.columns["tick"], tick))
        return int(self._recorded.columns["tick"][self._row_index]) == tick

    def _compare_rows(
        self, columns: dict[str, np.ndarray], at: int, recorded: RowBlock, begin: int, count: int
    ) -> None:
        unequal = np.zeros(count, bool)
        names: list[str] = []
        for path, values in columns.items():
            if path == "tick" or path not in recorded.columns:
                continue
            before, now = recorded.columns[path][begin : begin + count], values[at : at + count]
            differ = before.view(np.uint64) != np.ascontiguousarray(now).view(np.uint64)
            differ &= ~(np.isnan(before) & np.isnan(now))  # any NaN means no value
            if differ.any():
                names.append(path)
                unequal |= differ
        self.result.compared_samples += count
        self.result.unequal_samples += int(np.count_nonzero(unequal))
        if names and self.result.first_unequal is None:
            tick = int(recorded.columns["tick"][begin + int(np.argmax(unequal))])
            self.result.first_unequal = f"{names[0]} at sample {tick - self._run_first_tick} of the run"


def _read_estimates(container: McapFile) -> Iterator[RowBlock]:
    for rows in container.iter_content(mcap_layout.ESTIMATES_TOPIC):
        assert isinstance(rows, RowBlock)
        yield rows


def find_configuration_differences(container: McapFile, recording_context: RecordingContext) -> list[str]:
    """Return the differences between a recording's configuration and this one that affect estimates.

    Raises:
        RecordingError: the file does not hold its configuration.
    """
    try:
        then = {name: json.loads(container.attachments[name]) for name in recording_context.attachments()}
    except (KeyError, ValueError) as error:
        raise RecordingError(f"{container.path}: its configuration cannot be read ({error}).") from None
    now = {name: json.loads(content) for name, content in recording_context.attachments().items()}
    for each in (then, now):
        each[mcap_layout.SETTINGS_ATTACHMENT] = {
            part: each[mcap_layout.SETTINGS_ATTACHMENT].get(part) for part in RELEVANT_SETTINGS
        }
    found = []
    for name, what in CONFIGURATION_NAMES.items():
        found += list(_iterate_differences(what, then[name], now[name]))
    if len(found) > MAX_DIFFERENCES:
        found = [*found[:MAX_DIFFERENCES], f"and {len(found) - MAX_DIFFERENCES} more"]
    return found


def _iterate_differences(place: str, then: Any, now: Any) -> Iterator[str]:
    if isinstance(then, dict) and isinstance(now, dict):
        for key in sorted({*then, *now}):
            yield from _iterate_differences(f"{place} {key}", then.get(key), now.get(key))
    elif then != now:
        yield f"{place}: recorded with {_shorten(then)}, now {_shorten(now)}"


def _shorten(value: Any) -> str:
    text = "nothing" if value is None else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
