"""The function that reads columns of numbers from a text: CSV, TSV, or columns separated by blanks."""

import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition.recordings.column_table import ColumnTable, Wanted, find_positions
from acquisition.recordings.text_file import count_decimals, read_text
from acquisition.table_columns import DECIMAL_EXCHANGE, QUOTES, TextFormat
from config.errors import RecordingError
from config.table_layout import DecimalMark, Separator, TableLayout

EXPECTED = "a table of numbers"
MAX_HEADER_LINES = 1000
PROBED_LINES = 100  # from which separator and number of columns are found
CHUNK_LINES = 2000  # read at once; of a chunk with a damaged line, every line is read by itself


@dataclass(frozen=True, slots=True)
class _Line:
    """A line that is neither blank nor a comment: its number from 1, and its text without junk at its end."""

    number: int
    text: str


def read_text_table(path: Path, layout: TableLayout, wanted: Wanted) -> ColumnTable:
    """Read the wanted columns of a text.

    Lines that begin with a comment mark, and lines of text before the first sample, are the file's header; the headings
    are the last of these lines that have the wanted names. Damaged lines are left out and counted.

    Raises:
        RecordingError: the file cannot be read, a column is missing, or no line holds numbers.
    """
    text = read_text(path, EXPECTED)
    raw = text.split("\n" if "\n" in text else "\r")
    junk = " \r" + layout.ignore_at_line_end
    marks = layout.comment_marks
    lines, comments = [], []
    for number, content in enumerate(raw, 1):
        stripped = content.rstrip(junk).lstrip(" ")
        if stripped.startswith(marks):
            comments.append(_Line(number, stripped))
        elif stripped.strip():
            lines.append(_Line(number, stripped))
    if not lines:
        raise RecordingError(f"{path}: holds no samples: all lines are blank or comments.")
    form, begin = _find_format(path, layout, lines)
    count = Counter(len(form.split(line.text)) for line in lines[begin : begin + PROBED_LINES]).most_common(1)[0][0]
    heading = _choose_heading(form, comments, lines[:begin], lines[begin].number, wanted, marks, count)
    where = f", line {heading[0].number}" if heading else f", line {lines[begin].number}"
    names = heading[1] if heading else [""] * count
    at = find_positions(path, where, names, count, wanted)
    if wanted is None:
        at = _choose_number_columns(form, lines[begin : begin + PROBED_LINES], at)
    samples = [line for line in lines[:begin] if not any(map(str.isalpha, line.text))] + lines[begin:]
    values = _read_values(form, samples, at, count)
    sound = np.asarray(np.isfinite(values).all(axis=1))
    if raw[-1].strip() and _is_cut_off(form, samples):
        sound[-1] = False
    rows = np.array([line.number for line in samples])
    damage = "" if sound.all() else _describe_damage(form, samples[int(np.argmin(sound))], at, count)
    if not sound.any():
        raise RecordingError(f"{path}, {damage}. Correct the columns, `separator` or `decimal` in [table].")
    return ColumnTable(
        values[sound],
        rows[sound],
        np.flatnonzero(sound),
        rows[~sound],
        damage,
        row_word="line",
        columns=tuple(index + 1 for index in at),
        names=tuple(names[index] for index in at),
    )


def _choose_number_columns(form: TextFormat, lines: Sequence[_Line], at: Sequence[int]) -> tuple[int, ...]:
    """Return those columns that hold a number in most of the lines."""
    rows = [form.split(line.text) for line in lines]
    whole = [[form.parse(row[index]) for index in at] for row in rows if len(row) > max(at)]
    numbers = np.isfinite(whole).mean(axis=0) > 0.5 if whole else np.zeros(len(at), bool)
    return tuple(index for index, is_number in zip(at, numbers, strict=True) if is_number)


def _find_format(path: Path, layout: TableLayout, lines: Sequence[_Line]) -> tuple[TextFormat, int]:
    """Return how lines are split, and the index of the first line that holds numbers.

    A separator that the layout does not state is the one that splits most lines into the same number of columns.
    """
    stated = [layout.separator] if layout.separator else list(Separator)
    if layout.decimal is DecimalMark.COMMA:
        stated = [each for each in stated if each is not Separator.COMMA]
    best: tuple[int, TextFormat | None, int] = (0, None, 0)
    for separator in stated:
        form = TextFormat(separator, layout.decimal)
        begin = next((i for i, line in enumerate(lines[:MAX_HEADER_LINES]) if form.count_numbers(line.text) > 1), None)
        if begin is None:
            continue
        counts = Counter(form.count_numbers(line.text) for line in lines[begin : begin + PROBED_LINES])
        counts = Counter({numbers: lines_ for numbers, lines_ in counts.items() if numbers > 1})
        if counts and (score := max(counts.values())) > best[0]:
            best = (score, form, begin)
    if best[1] is None:
        name = (
            f"separated by {layout.separator}" if layout.separator else "separated by tab, comma, semicolon or blanks"
        )
        raise RecordingError(
            f"{path}, line {lines[0].number}: found no line with columns of numbers that are {name}, with a decimal "
            f"{layout.decimal}. Correct `separator` and `decimal` in [table] of the tool file, or export the recording "
            "as text."
        )
    return best[1], best[2]


def _choose_heading(
    form: TextFormat,
    comments: Sequence[_Line],
    header: Sequence[_Line],
    first_sample: int,
    wanted: Wanted,
    marks: tuple[str, ...],
    count: int,
) -> tuple[_Line, list[str]] | None:
    """Return the line of the headings, and these; None if no line before the samples can be theirs.

    It is the last one with most of the wanted names, and among lines without them, the last one.
    """
    names = {name.strip().casefold() for name in wanted or () if isinstance(name, str)}
    best: tuple[int, _Line, list[str]] | None = None
    before = sorted((*(each for each in comments if each.number < first_sample), *header), key=lambda each: each.number)
    for line in before[-MAX_HEADER_LINES:]:
        text = line.text
        for mark in marks:
            text = text.removeprefix(mark)
        cells = [
            cell.strip(QUOTES) for cell in form.split(text.strip() if form.separator is Separator.BLANKS else text)
        ]
        if len(cells) == count + 1 and not cells[0]:  # a separator follows the comment mark
            cells = cells[1:]
        found = len(names & {cell.casefold() for cell in cells})
        fits = len(cells) == count or (found and form.separator is not Separator.BLANKS)  # names may contain blanks
        if fits and (best is None or found >= best[0]):
            best = (found, line, cells)
    return best[1:] if best else None


def _read_values(form: TextFormat, samples: Sequence[_Line], at: Sequence[int], count: int) -> np.ndarray:
    """Return the columns of all lines, (lines, columns); NaN in a line that is damaged."""
    chunks = []
    for begin in range(0, len(samples), CHUNK_LINES):
        chunk = samples[begin : begin + CHUNK_LINES]
        values = _read_sound_chunk(form, chunk, at, count)
        chunks.append(np.array([_read_line(form, line, at, count) for line in chunk]) if values is None else values)
    return np.concatenate(chunks)


def _read_sound_chunk(form: TextFormat, chunk: Sequence[_Line], at: Sequence[int], count: int) -> np.ndarray | None:
    """Return the columns of lines that are all sound, or None."""
    mark = form.separator.character
    if any((line.text.count(mark) + 1 if mark else len(line.text.split())) != count for line in chunk):
        return None
    text = "\n".join(line.text for line in chunk)
    if form.decimal is DecimalMark.COMMA:
        text = text.translate(DECIMAL_EXCHANGE)
        mark = mark.translate(DECIMAL_EXCHANGE) if mark else mark
    try:
        return np.loadtxt(io.StringIO(text), delimiter=mark, usecols=at, ndmin=2, comments=None, quotechar='"')
    except ValueError:
        return None


def _read_line(form: TextFormat, line: _Line, at: Sequence[int], count: int) -> list[float]:
    cells = form.split(line.text)
    return [form.parse(cells[each]) for each in at] if len(cells) == count else [np.nan] * len(at)


def _is_cut_off(form: TextFormat, samples: Sequence[_Line]) -> bool:
    """Return whether the last line, which has no end, has fewer decimals in its last number than the line above."""
    above, last = (form.split(samples[at].text) for at in (max(len(samples) - 2, 0), -1))
    return count_decimals(last[-1]) < count_decimals(above[-1])


def _describe_damage(form: TextFormat, line: _Line, at: Sequence[int], count: int) -> str:
    cells = form.split(line.text)
    if len(cells) != count:
        return f"line {line.number}: expected {count} columns, found {len(cells)}"
    bad = next((each for each in at if not np.isfinite(form.parse(cells[each]))), None)
    if bad is None:
        return f"line {line.number}: is cut off in its last number"
    return f"line {line.number}: expected a number in column {bad + 1}, found {cells[bad].strip()[:40]!r}"
