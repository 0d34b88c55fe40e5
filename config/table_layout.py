"""Typed models of a tool file's `[table]`: which column of another program's recordings is which signal."""

from enum import StrEnum
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from config.config_model import ConfigModel, Finite, NonZero, Positive, Slug
from config.units import check_unit, find_conversion_factor


class Separator(StrEnum):
    """What stands between the columns of a text."""

    TAB = "tab"
    COMMA = "comma"
    SEMICOLON = "semicolon"
    BLANKS = "blanks"

    @property
    def character(self) -> str | None:
        """The character, or None for any number of blanks."""
        return {"tab": "\t", "comma": ",", "semicolon": ";"}.get(self.value)


class DecimalMark(StrEnum):
    """Decimal mark of the numbers in a text table."""

    POINT = "point"
    COMMA = "comma"


def _check_place(place: int | str) -> int | str:
    if isinstance(place, int) and place < 1:
        raise ValueError("columns count from 1")
    if isinstance(place, str) and not place.strip():
        raise ValueError("the heading is empty; write the column's number instead")
    return place


def _check_time_unit(unit: str) -> str:
    find_conversion_factor(unit, "s")
    return unit


ColumnPlace = Annotated[int | str, AfterValidator(_check_place)]


class TimeColumn(ConfigModel):
    """The column of the times."""

    column: ColumnPlace
    """Number of the column, counted from 1, or its heading."""
    unit: Annotated[str, AfterValidator(_check_time_unit)]
    """Unit of the times in the file: `s`, `ms`, `us`."""


class TableColumn(ConfigModel):
    """A signal's column: the signal is the value, converted to the signal's unit, times `scale`, plus `offset`."""

    signal: Slug
    """Signal in Graspwatch: `strain_v` (the force sensor) and `encoder_deg` (the position sensor) are needed;
    `motor_command_v`, `touch_1_v` and `touch_2_v` are optional."""
    column: ColumnPlace
    """Number of the column, counted from 1, or its heading; in a TDMS file the channel, in a MAT file the variable."""
    unit: Annotated[str, AfterValidator(check_unit)]
    """Unit in the file, such as `mV` or `rad`. Empty for raw numbers and for other quantities; then `scale` converts
    them to the signal's unit."""
    scale: NonZero = 1.0
    """Factor, negative to change the sign."""
    offset: Finite = 0.0
    """What is added after the scale, in the signal's unit."""


class TableLayout(ConfigModel):
    """Columns of recordings that are tables: text (CSV, TSV, blanks), TDMS, MAT or Parquet files."""

    separator: Separator | None = None
    """What separates the columns of a text: `tab`, `comma`, `semicolon` or `blanks`; without it, it is found."""
    decimal: DecimalMark = DecimalMark.POINT
    """Decimal mark of the numbers in a text: `point` or `comma`."""
    comment_marks: tuple[Annotated[str, Field(min_length=1)], ...] = ("%", "#")
    """Beginnings of lines of a text that hold no samples."""
    ignore_at_line_end: str = ""
    """Characters that are ignored at the ends of lines, beside blanks."""
    time: TimeColumn | None = None
    """Column of the times. Times that jitter are allowed: the samples are interpolated at the board's sample rate."""
    rate_hz: Positive | None = None
    """Samples a second, Hz; needed without times. Times that contradict it are refused."""
    columns: tuple[TableColumn, ...] = Field(min_length=1)
    """The columns of the signals: one table each."""

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        signals = [each.signal for each in self.columns]
        if twice := next((name for name in signals if signals.count(name) > 1), None):
            raise ValueError(f"{twice} has two columns: leave one out")
        if self.decimal is DecimalMark.COMMA and self.separator is Separator.COMMA:
            raise ValueError("the comma cannot separate columns and decimals")
        return self
