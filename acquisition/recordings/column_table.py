"""The class ColumnTable: the columns of a file that holds a table of numbers, before units and times are applied."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from config.errors import RecordingError

MAX_LISTED_NAMES = 30


@dataclass(frozen=True, slots=True)
class ColumnTable:
    """The wanted columns of a table file.

    `values` has shape (n, wanted columns), in the order in which they were asked for; every value is finite. `rows`
    (n,) are the numbers of the rows in the file, from 1; `row_word` says whether these are lines of a text.
    `positions` (n,) count samples from 0, damaged rows included, for files without times. `damaged` are the numbers of
    the rows that were left out; `damage` describes the first of them. `step_s` is the time between samples and
    `start_ns` the time of the first one, if the file says so. `columns` are the numbers of the columns in the file,
    from 1, and `names` their headings; a column without one has an empty name.
    """

    values: np.ndarray
    rows: np.ndarray
    positions: np.ndarray
    damaged: np.ndarray
    damage: str = ""
    row_word: str = "row"
    step_s: float | None = None
    start_ns: int | None = None
    columns: tuple[int, ...] = ()
    names: tuple[str, ...] = ()


Wanted = Sequence[int | str] | None
"""Numbers (from 1) or headings of columns; None: all columns that hold numbers."""


def find_positions(path: Path, where: str, names: Sequence[str], count: int, wanted: Wanted) -> tuple[int, ...]:
    """Return the index of each wanted column by its number (from 1) or its heading, in small or capital letters.

    `where` names the line of the headings in messages; `count` is the number of columns.

    Raises:
        RecordingError: a column is not there, or its heading stands twice.
    """
    if wanted is None:
        return tuple(range(count))
    return tuple(_find_position(path, where, names, count, each) for each in wanted)


def _find_position(path: Path, where: str, names: Sequence[str], count: int, wanted: int | str) -> int:
    if isinstance(wanted, int):
        if wanted > count:
            raise RecordingError(
                f"{path}{where}: has {count} columns, but [table] of the tool file names column {wanted}. Correct the "
                "column or the separator in [table], or name another tool file with --tool."
            )
        return wanted - 1
    found = [at for at, name in enumerate(names) if name.strip().casefold() == wanted.strip().casefold()]
    if len(found) == 1 and found[0] < count:
        return found[0]
    if len(found) == 1:
        raise RecordingError(
            f"{path}{where}: the heading {wanted!r} stands in column {found[0] + 1}, but the samples have {count} "
            "columns. Correct the headings in a copy, or write the columns' numbers into [table] of the tool file."
        )
    if found:
        raise RecordingError(
            f"{path}{where}: the heading {wanted!r} stands in columns {', '.join(str(at + 1) for at in found)}. Write "
            "the number of the column that is meant into [table] of the tool file."
        )
    shown = [name for name in names if name][:MAX_LISTED_NAMES]
    raise RecordingError(
        f"{path}{where}: there is no column {wanted!r}; found {', '.join(shown) or 'no headings'}. Correct the column "
        "in [table] of the tool file, or name another tool file with --tool."
    )


def build_table(
    path: Path,
    columns: Sequence[np.ndarray],
    at: Sequence[int],
    names: Sequence[str],
    step_s: float | None = None,
    start_ns: int | None = None,
) -> ColumnTable:
    """Return the table of columns (n,) of a file that is no text; rows with a value that is not finite are left out.

    `at` are the columns' indices in the file, `names` their names.

    Raises:
        RecordingError: the columns have different lengths or hold no samples.
    """
    lengths = sorted({len(column) for column in columns})
    if len(lengths) > 1:
        raise RecordingError(
            f"{path}: its columns have between {lengths[0]} and {lengths[-1]} values; expected one of each at every "
            "sample. Name columns that were sampled together in [table] of the tool file."
        )
    values = np.column_stack(columns)
    sound = np.isfinite(values).all(axis=1)
    if not sound.any():
        raise RecordingError(f"{path}: holds no samples in the columns that [table] of the tool file names.")
    kept, damaged = np.flatnonzero(sound), np.flatnonzero(~sound) + 1
    damage = f"row {damaged[0]}: has a value that is not a finite number" if len(damaged) else ""
    return ColumnTable(
        values[sound],
        kept + 1,
        kept,
        damaged,
        damage,
        step_s=step_s,
        start_ns=start_ns,
        columns=tuple(index + 1 for index in at),
        names=tuple(names),
    )
