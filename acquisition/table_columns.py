"""What `[table]` of a tool file says about a line of numbers: its cells, and the factors to the signals' units."""

from dataclasses import dataclass

import numpy as np

from acquisition.signal_table import SENSOR_SIGNALS
from config.errors import RecordingError
from config.schema import Tool
from config.table_layout import DecimalMark, Separator, TableColumn, TableLayout
from config.units import find_conversion_factor

NEEDED_SIGNALS = {"strain_v": "the force sensor", "encoder_deg": "the position sensor"}
DECIMAL_EXCHANGE = str.maketrans(",.", ".,")  # so that a point among decimal commas is no number
QUOTES = "\"' \t"


@dataclass(frozen=True, slots=True)
class TextFormat:
    """How a line splits into cells, and a cell becomes a number."""

    separator: Separator
    decimal: DecimalMark

    def split(self, text: str) -> list[str]:
        return text.split(self.separator.character)

    def parse(self, cell: str) -> float:
        """Return the number in a cell, NaN if it holds none."""
        text = cell.strip(QUOTES)
        if self.decimal is DecimalMark.COMMA:
            text = text.translate(DECIMAL_EXCHANGE)
        try:
            return float(text) if text.isascii() and "_" not in text else np.nan
        except ValueError:
            return np.nan

    def count_numbers(self, text: str) -> int:
        return int(np.isfinite([self.parse(cell) for cell in self.split(text)]).sum())


def find_factors(layout: TableLayout, tool: Tool) -> list[float]:
    """Return the factor of each column from its unit to that of its signal.

    Raises:
        RecordingError: a needed signal has no column, there is no such signal, or the units do not fit.
    """
    known = {signal.name: signal.unit for signal in SENSOR_SIGNALS}
    where = f"[table] of the tool file {tool.name!r}"
    named = [each.signal for each in layout.columns]
    for signal, meaning in NEEDED_SIGNALS.items():
        if signal not in named:
            raise RecordingError(
                f"{where} names no column for {signal}, {meaning}. Add a [[table.columns]] with this signal."
            )
    if unknown := [name for name in named if name not in known]:
        raise RecordingError(f"{where}: there is no signal {unknown[0]!r}. There is: {', '.join(known)}.")
    return [_find_factor(where, column, known[column.signal]) for column in layout.columns]


def _find_factor(where: str, column: TableColumn, unit: str) -> float:
    if not column.unit:
        return 1.0
    try:
        return find_conversion_factor(column.unit, unit)
    except ValueError as error:
        raise RecordingError(
            f"{where}: the unit of column {column.column!r} does not fit {column.signal}: {error}. Correct the unit; "
            f'for a sensor of another quantity write unit = "", and as `scale` how many {unit} one {column.unit} is.'
        ) from None
