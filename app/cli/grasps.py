"""`graspwatch grasps`: one tidy table of the grasps of many recordings."""

import operator
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from app.cli.grasp_collection import collect, find_files, read_corrections
from app.cli.label_option import LABEL_HELP, LABEL_METAVAR
from app.cli.options import (
    DEFAULT_RECORDING_TOOL,
    ConfigOption,
    DataOption,
    LibraryOption,
    ToolOption,
    explain_write_errors,
    locate_data_folder,
)
from config.atomic_write import check_writable
from config.errors import ConfigurationError, RecordingError
from config.load import load_library, load_settings, load_tool

if TYPE_CHECKING:
    from app.recordings.grasp_rows import Row

FORMATS = (".parquet", ".csv")
OPERATORS: dict[str, Callable[[Any, Any], bool]] = {
    "=": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
    ">=": operator.ge,
    "<=": operator.le,
}
Condition = tuple[str, str, str]
"""A column, a sign of OPERATORS and the text of a value."""
CONDITION = re.compile(r"\s*(\w+)\s*(!=|>=|<=|=|>|<)\s*(.*?)\s*")
SHOWN_COLUMNS = {
    "recording": "Recording",
    "index": "#",
    "truth": "Truth",
    "label": "Answer",
    "probability": "Prob.",
    "peak_force_n": "Peak N",
    "dose_n_s": "N s",
    "why_invalid": "Remark",
}
MAX_SHOWN_ROWS = 50


def grasps(
    recordings: Annotated[
        list[Path] | None, typer.Argument(metavar="FILE...", help="Recordings: .mcap, LabVIEW's .lvm, or tables.")
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All recordings of the data folder that can be read.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the table to this .parquet or .csv file.")
    ] = None,
    where: Annotated[
        list[str] | None,
        typer.Option(metavar="CONDITION", help="Only grasps with `truth=liver`, `peak_force_n>2`; repeat it."),
    ] = None,
    label: Annotated[
        list[str] | None, typer.Option(metavar=LABEL_METAVAR, help=f"{LABEL_HELP} It counts as the grasps' truth.")
    ] = None,
    library: LibraryOption = None,
    tool: ToolOption = None,
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """Make one table of the grasps of many recordings: a row a grasp, with what was held and what was answered.

    Without --library an .mcap recording keeps the answers that it was recorded with; with it, all are estimated anew.

    Example: graspwatch grasps --all --where valid=true --out grasps.parquet
    """
    settings = load_settings(config)
    own = locate_data_folder(data, settings)
    conditions = [_parse_condition(text) for text in where or []]
    if out and out.suffix not in FORMATS:
        raise ConfigurationError(f"{out}: the name must end with .parquet or .csv.")
    if out and out.exists():
        raise ConfigurationError(f"{out}: exists already, and is kept. Name another file with --out.")
    if out:
        with explain_write_errors(out):
            check_writable(out.parent)
    files, labels = find_files(recordings, label, everything=everything, data=data, settings=settings)
    named = load_library(library, own) if library else None
    log_tool, default = load_tool(tool or DEFAULT_RECORDING_TOOL, own), named or load_library(settings.library, own)

    from app.analysis.grasp_collection import EstimationContext  # a slow import, made after the options are checked

    how = EstimationContext(log_tool, settings, named, default)
    rows = collect(files, how, read_corrections(files, own, settings), labels, {*(recordings or []), *labels})
    if not rows:
        raise RecordingError(f"None of the {len(files)} recordings has a grasp: nothing is written.")
    rows = _filter(rows, conditions)
    if out:
        _write(rows, out)
        print(f"{out}: {len(rows)} grasps of {len(files)} recordings")
    else:
        _print(rows)


def _parse_condition(text: str) -> Condition:
    found = CONDITION.fullmatch(text)
    if not found:
        raise ConfigurationError(f"--where {text}: expected a column, =, !=, <, <=, > or >=, and a value.")
    return found[1], found[2], found[3]


def _filter(rows: list["Row"], conditions: list[Condition]) -> list["Row"]:
    """Return the rows that fulfil all conditions; an empty cell fulfils none.

    Raises:
        ConfigurationError: a condition names no column, its value does not fit, or no row fulfils them.
    """
    kept = rows
    for name, sign, text in conditions:
        values = [row[name] for row in rows if row.get(name) is not None]
        if not values:
            there = ", ".join(dict.fromkeys(key for row in rows for key in row))
            raise ConfigurationError(f"--where {name}{sign}{text}: no grasp has a value there. Columns: {there}.")
        wanted = _read_value(values[0], f"--where {name}{sign}{text}", text)
        kept = [row for row in kept if row.get(name) is not None and OPERATORS[sign](row[name], wanted)]
    if not kept:
        raise ConfigurationError(f"None of the {len(rows)} grasps fulfils --where: nothing is written.")
    return kept


def _read_value(example: object, where: str, text: str) -> object:
    """Return the text as a value of the example's type."""
    if isinstance(example, str):
        return text
    if isinstance(example, bool):
        if text not in ("true", "false"):
            raise ConfigurationError(f"{where}: the column holds true or false.")
        return text == "true"
    try:
        return float(text)
    except ValueError:
        raise ConfigurationError(f"{where}: the column holds numbers.") from None


def _write(rows: list["Row"], out: Path) -> None:
    from app.analysis.grasp_collection import build_table, write_table

    table = build_table(rows)
    part = out.with_name(f".{out.name}.part")
    with explain_write_errors(out):
        try:
            write_table(table, out.suffix, part)
            part.rename(out)
        finally:
            part.unlink(missing_ok=True)


def _print(rows: list["Row"]) -> None:
    from rich.table import Table

    from app.cli.console import create_console, print_note

    shown = Table(title=f"{len(rows)} grasp{'s'[: len(rows) != 1]}")
    for name, heading in SHOWN_COLUMNS.items():
        shown.add_column(heading, no_wrap=name != "why_invalid")
    for row in rows[:MAX_SHOWN_ROWS]:
        shown.add_row(*(_format(row.get(name)) for name in SHOWN_COLUMNS))
    create_console().print(shown)
    if len(rows) > MAX_SHOWN_ROWS:
        print_note(f"The first {MAX_SHOWN_ROWS} are shown. --out writes all, with every column.")


def _format(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return "" if value is None else str(value)
