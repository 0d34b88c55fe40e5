"""`graspwatch tool new`: a tool file from a recording of another program."""

from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
import typer
from rich.table import Table

from app.cli.console import create_console, error_console, print_note
from app.cli.options import ConfigOption, DataOption, prepare_data_folder
from config.atomic_write import write_atomically
from config.errors import ConfigurationError
from config.load import FileKind, list_names, load_settings, load_tool
from config.schema import ConditioningSettings, Tool

BARS = "▁▂▃▄▅▆▇█"

app = typer.Typer(help="Tool files for recordings of other programs.", no_args_is_help=True)
AnswerT = TypeVar("AnswerT", int, float)


@app.callback()
def tool() -> None:
    """Tool files for recordings of other programs."""


@app.command()
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Of the new tool: small letters, digits and _.")],
    recording: Annotated[
        Path, typer.Option("--from", metavar="FILE", help="Recording: a text with columns, TDMS, MAT or Parquet.")
    ],
    force: Annotated[int | None, typer.Option(min=1, metavar="COLUMN", help="Column of the force sensor.")] = None,
    position: Annotated[
        int | None, typer.Option(min=1, metavar="COLUMN", help="Column of the position sensor: angle or opening.")
    ] = None,
    command: Annotated[
        int | None, typer.Option(min=0, metavar="COLUMN", help="Column of the motor command, V; 0: driven by hand.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(min=1, metavar="HZ", help="Samples a second, of a file without times.")
    ] = None,
    newton: Annotated[
        float | None, typer.Option(min=1e-9, metavar="N", help="Newtons at the jaws for one unit of the force column.")
    ] = None,
    millimetre: Annotated[
        float | None, typer.Option(min=1e-9, metavar="MM", help="Jaw travel for one unit of the position column.")
    ] = None,
    port: Annotated[
        str | None,
        typer.Option(metavar="PORT", help="Serial port that prints such lines, to watch the tool live: /dev/ttyACM0."),
    ] = None,
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """Show the columns of a recording, ask what is what, write the tool file, and replay the first grasps.

    Options answer questions beforehand; with --force and --position, nothing is asked. With --port, `serve --tool NAME`
    watches the device that printed the recording.

    Example: graspwatch tool new my_punch --from muscle.txt.gz --force 2 --position 4 --newton 0.0098
    """
    from acquisition.recordings.column_survey import guess_times, survey_columns
    from app.analysis.tool_draft import PLOT_PARTS, ColumnAnswers

    settings = load_settings(config)
    folder = prepare_data_folder(data, settings)
    if name in list_names(FileKind.TOOL, folder):
        raise ConfigurationError(f"There is a tool {name!r} already. Choose another name.")
    columns = {column.number: column for column in survey_columns(recording)}
    times = guess_times(list(columns.values()))
    console = create_console()
    table = Table("Column", "Heading", "Lowest", "Highest", title=str(recording))
    table.add_column("Plot", no_wrap=True, min_width=PLOT_PARTS)
    for column in columns.values():
        low, high = column.values.min(), column.values.max()
        table.add_row(str(column.number), column.name, f"{low:g}", f"{high:g}", _plot(column.values))
    console.print(table)
    if times:
        console.print(f"Column {times.column} holds the times, in {times.unit}: {times.rate_hz:.4g} samples a second.")
    asks = force is None or position is None

    def answer(given: AnswerT | None, question: str, default: AnswerT | None, option: str) -> AnswerT | None:
        if given is not None or not asks:
            return given
        if not error_console.is_terminal:
            raise ConfigurationError(f"Nobody is at a terminal to answer: {question} Say it with {option}.")
        return typer.prompt(question, default=default, type=type(default) if default is not None else int, err=True)

    force = answer(force, "Which column is the force sensor?", None, "--force")
    position = answer(position, "Which column is the position sensor?", None, "--position")
    command = answer(command, "Which column is the motor command (0: the tool is driven by hand)?", 0, "--command")
    newton = answer(newton, "How many newtons at the jaws is one unit of the force (0: not known)?", 0.0, "--newton")
    millimetre = answer(
        millimetre, "How many millimetres do the jaws move for one unit of the position (0: not known)?", 0.0,
        "--millimetre",
    )  # fmt: skip
    if not times:
        rate = answer(rate, "How many samples a second are there?", 1000.0, "--rate")
    answers = ColumnAnswers(name, force, position, command, newton, millimetre, rate, port)
    draft = answers.build_draft(columns, times, str(recording))
    path = folder / FileKind.TOOL.folder / f"{name}.toml"
    text = draft.build_text(recording.name, date.today())
    path.parent.mkdir(exist_ok=True)
    write_atomically(path, text)
    console.print(f"Written: {path}", soft_wrap=True)
    for what in answers.assumed:
        print_note(f"The {what} are assumed. Correct them under [kinematics] in the file, or say --{what[:-1]}.")
    if port:
        console.print(f"Watch it live: graspwatch serve --tool {name}")
    _show_first_grasps(recording, load_tool(name, folder), settings.conditioning, console.print)


def _plot(values: np.ndarray) -> str:
    """Return a line of bars, each the mean of a part of the values."""
    from app.analysis.tool_draft import compute_part_means

    means = compute_part_means(values)
    span = float(np.ptp(means)) or 1.0
    heights = np.round((means - means.min()) / span * (len(BARS) - 1)).astype(int)
    return "".join(BARS[height] for height in heights.tolist())


def _show_first_grasps(
    recording: Path, own: Tool, conditioning: ConditioningSettings, write: Callable[..., None]
) -> None:
    """Show what the new tool file makes of the recording's first grasps."""
    from app.analysis.tool_draft import SHOWN_GRASPS, summarize_grasps

    grasps = summarize_grasps(recording, own, conditioning)
    title = f"{len(grasps)} grasps found" + (
        f", the first {SHOWN_GRASPS} of them" if len(grasps) > SHOWN_GRASPS else ""
    )
    table = Table("Grasp", "Start", "Lasts", "Peak force", "Jaw travel", "Contact", title=title)
    for each in grasps[:SHOWN_GRASPS]:
        table.add_row(
            str(each.number),
            f"{each.start_s:.2f} s",
            f"{each.duration_s:.2f} s",
            f"{each.peak_force_n:.2f} N",
            f"{1e3 * each.travel_m:.1f} mm",
            "yes" if each.has_contact else "no",
        )
    write(table)
    if not grasps:
        print_note("No grasp was found. Look at closing_deg under [hand_driven], or at the motor command's column.")
        return
    print_note(f"Next: graspwatch replay {recording} --tool {own.name} --serve")
