"""What the columns of another program's recording look like, and which of them holds the times."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition.recordings.table_log import read_table
from config.table_layout import TableColumn, TableLayout
from config.units import find_conversion_factor

IGNORED_AT_LINE_END = "\\;"  # a separator or a backslash after the last column
TIME_UNITS = ("s", "ms", "us")
RATES_HZ = (20.0, 20_000.0)  # of recordings that a time column may have
REST_SHARE = 0.15  # beginning of a recording, in which the jaws are mostly open
PROTRUDING_PERCENTILES = (1.0, 99.0)  # spikes are no range


@dataclass(frozen=True, slots=True)
class SurveyedColumn:
    """A column with numbers: its number in the file from 1, its heading (may be empty), and its values (n,)."""

    number: int
    name: str
    values: np.ndarray

    @property
    def rest(self) -> float:
        """Its value with open jaws: the median of the beginning. Later a tool may lie about with shut jaws."""
        return float(np.median(self.values[: max(round(REST_SHARE * len(self.values)), 1)]))

    @property
    def reach(self) -> float:
        """How far it goes from rest; below 0 if it falls."""
        low, high = (np.percentile(self.values, PROTRUDING_PERCENTILES) - self.rest).tolist()
        return high if high >= -low else low

    @property
    def sign(self) -> float:
        """1 if it rises from rest, -1 if it falls."""
        return 1.0 if self.reach >= 0.0 else -1.0

    @property
    def span(self) -> float:
        """How far it goes from rest, without its sign."""
        return abs(self.reach)

    @property
    def noise_sd(self) -> float:
        """Standard deviation of one value while nothing happens, from the median step between values."""
        return float(np.median(np.abs(np.diff(self.values)))) / 0.954  # 0.6745 sqrt(2), of a normal distribution

    @property
    def step(self) -> float:
        """Smallest difference between two of its values."""
        differences = np.diff(np.unique(self.values))
        return float(differences.min()) if len(differences) else 0.0


@dataclass(frozen=True, slots=True)
class TimeGuess:
    """A column that looks like times: its number, their unit, and the samples a second by it."""

    column: int
    unit: str
    rate_hz: float


def survey_columns(path: Path) -> list[SurveyedColumn]:
    """Read all columns of a recording that hold numbers.

    Raises:
        RecordingError: the file cannot be read, or holds no columns of numbers.
    """
    table = read_table(path, any_layout(), None)
    rows = zip(table.columns, table.names, table.values.T, strict=True)
    return [SurveyedColumn(number, name, values) for number, name, values in rows]


def any_layout() -> TableLayout:
    """Return a layout that finds separator and header of a text by itself."""
    unused = TableColumn(signal="strain_v", column=1, unit="")
    return TableLayout(columns=(unused,), ignore_at_line_end=IGNORED_AT_LINE_END)


def guess_times(columns: list[SurveyedColumn]) -> TimeGuess | None:
    """Return the first column whose values rise evenly, in the unit that gives a usual rate; None if there is none."""
    for column in columns:
        steps = np.diff(column.values)
        usual = float(np.median(steps)) if len(steps) else 0.0
        if usual <= 0 or np.percentile(steps, 1.0) < 0 or np.percentile(steps, 99.0) > 4 * usual:
            continue
        mean = float(steps[steps <= 10 * usual].mean())
        for unit in TIME_UNITS:
            rate_hz = 1.0 / (mean * find_conversion_factor(unit, "s"))
            if RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
                return TimeGuess(column.number, unit, rate_hz)
    return None
