"""`graspwatch calibrate fit`: the map from a drive's signals to the jaw force, from paired recordings."""

import json
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from app.cli.console import create_console, print_note
from app.cli.options import JsonOption, write_output
from config.errors import ConfigurationError

if TYPE_CHECKING:
    from acquisition.bench.paired_fit import PairedFit, PairedSignals

REQUIRED_COLUMNS = ("drive-force", "drive-position", "jaw-force")
EXAMPLE_COLUMNS = "drive-force=3,drive-position=2,jaw-force=6"
COEFFICIENT_KEYS = ("offset", "per_drive_force", "per_drive_position")
PLOTTED_SAMPLES = 2000  # of each recording

FilesArgument = Annotated[
    list[Path], typer.Argument(metavar="FILE…", help="Recordings of both sides: text with columns, .gz too.")
]
ColumnsOption = Annotated[
    str,
    typer.Option(
        metavar="NAME=N,…",
        help=f"Column of each signal, counted from 1: {', '.join(REQUIRED_COLUMNS)}, and time if there is one.",
    ),
]
HoldOutOption = Annotated[
    bool, typer.Option(help="Judge each file by a fit to the others, if there are two files or more.")
]
PlotOption = Annotated[Path | None, typer.Option(metavar="FILE.html", help="Write loops and residuals as a page.")]
OutOption = Annotated[Path | None, typer.Option(metavar="FILE.toml", help="Write the map, as a table for a tool file.")]


def fit(
    files: FilesArgument,
    columns: ColumnsOption,
    hold_out: HoldOutOption = True,
    plot: PlotOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Map from drive force and position to the jaw force, with friction of both directions, from paired recordings.

    Record the drive's signals beside a trusted sensor at the jaws: full strokes in both directions, under at least two
    loads. All values have the units of their columns.

    Example: graspwatch calibrate fit bench*.csv --columns drive-force=3,drive-position=2,jaw-force=6 --out fit.toml
    """
    positions = _parse_columns(columns)
    from acquisition.bench.paired_fit import fit_pairs  # a slow import

    pairs, times = _read_pairs(files, positions)
    result = fit_pairs(pairs, hold_out)
    if out:
        write_output(out, _format_toml(result), "--out")
    if plot:
        write_output(plot, _render_plots(result, pairs, times), "--plot")
    if as_json:
        print(json.dumps(_build_document(result), indent=2, allow_nan=False))
    else:
        _print_result(result)
        for path in filter(None, (out, plot)):
            create_console().print(f"Written: {path}", soft_wrap=True)
    if len(files) == 1:
        print_note(
            "One file cannot show how well the map holds for another load. Record several loads, and name all files."
        )


def _parse_columns(text: str) -> dict[str, int]:
    found: dict[str, int] = {}
    for part in text.split(","):
        name, _, position = part.strip().partition("=")
        if name not in (*REQUIRED_COLUMNS, "time") or not position.isdecimal() or int(position) < 1 or name in found:
            raise ConfigurationError(f"--columns takes each signal's column like {EXAMPLE_COLUMNS}; found: {part}")
        found[name] = int(position)
    if missing := [name for name in REQUIRED_COLUMNS if name not in found]:
        raise ConfigurationError(f"--columns does not name {' and '.join(missing)}: add them like {EXAMPLE_COLUMNS}")
    if len(set(found.values())) < len(found):
        raise ConfigurationError(f"--columns names one column for two signals: correct {text}")
    return found


def _read_pairs(files: list[Path], positions: dict[str, int]) -> "tuple[list[PairedSignals], list[list[float]]]":
    import numpy as np  # slow imports

    from acquisition.bench.column_text import read_columns
    from acquisition.bench.paired_fit import PairedSignals
    from config.errors import RecordingError

    if len({path.resolve() for path in files}) < len(files):
        raise ConfigurationError("A file is named twice, so it cannot be held out: name each file once.")
    pairs: list[PairedSignals] = []
    times: list[list[float]] = []
    for path in files:
        read = read_columns(path, positions)
        pairs.append(PairedSignals(path.name, *(read[name] for name in REQUIRED_COLUMNS)))
        time = read.get("time", np.arange(len(read["jaw-force"])))
        if (back := np.flatnonzero(np.diff(time) < 0)).size:
            raise RecordingError(
                f"{path}: the time goes back from {time[back[0]]:g} to {time[back[0] + 1]:g}. Split the file there, or "
                "name another column."
            )
        times.append(time.tolist())
    return pairs, times


def _list_coefficients(result: "PairedFit") -> list[tuple[str, str, float, float, float]]:
    """Return direction, key, value, and the ends of the 95 % interval of each coefficient."""
    keys = [(direction, key) for direction in ("forward", "backward") for key in COEFFICIENT_KEYS]
    values = zip(result.drive_map.coefficients.tolist(), result.low.tolist(), result.high.tolist(), strict=True)
    return [(*key, *value) for key, value in zip(keys, values, strict=True)]


def _build_document(result: "PairedFit") -> dict[str, object]:
    return {
        "residual_sd": result.drive_map.residual_sd,
        "mean_held_out_rms": result.mean_held_out_rms,
        "reversal_travel": result.drive_map.reversal_travel,
        "strokes": result.strokes,
        "coefficients": [
            {"direction": direction, "name": key, "value": value, "low": low, "high": high}
            for direction, key, value, low, high in _list_coefficients(result)
        ],
        "files": [
            {"file": each.name, "own_rms": each.own_rms, "held_out_rms": each.held_out_rms} for each in result.files
        ],
    }


def _print_result(result: "PairedFit") -> None:
    from rich.table import Table  # a slow import

    console = create_console()
    files = Table("File", "Fitted on others", "Fitted on all", title="Residual RMS, units of the jaw force")
    for each in result.files:
        files.add_row(
            each.name, "–" if each.held_out_rms is None else f"{each.held_out_rms:.4g}", f"{each.own_rms:.4g}"
        )
    if result.mean_held_out_rms is not None:
        own = sum(each.own_rms for each in result.files) / len(result.files)
        files.add_row("mean", f"{result.mean_held_out_rms:.4g}", f"{own:.4g}", style="bold")
    console.print(files)
    coefficients = Table("Motion", "Coefficient", "Value", "95 %", title="Jaw force while the drive moves")
    for direction, key, value, low, high in _list_coefficients(result):
        coefficients.add_row(direction, key, f"{value:.5g}", f"{low:.5g} to {high:.5g}")
    console.print(coefficients)
    console.print(
        f"Standard uncertainty of a force: {result.drive_map.residual_sd:.4g}, once the drive has moved by "
        f"{result.drive_map.reversal_travel:.4g}. {result.strokes} strokes.",
        soft_wrap=True,
    )


def _format_toml(result: "PairedFit") -> str:
    fitted = result.drive_map
    lines = [
        "# While the drive moves: jaw force = offset + per_drive_force * drive force + per_drive_position * position.",
        "# Between both directions the force keeps its value. Units: those of the recordings' columns.",
        "[kinematics]",
        'kind = "drive_fit"',
        f"date = {date.today()}",
        f"source = {json.dumps([each.name for each in result.files], ensure_ascii=False)}",
        f"residual_sd = {fitted.residual_sd!r}",
        f"reversal_travel = {fitted.reversal_travel!r}",
        f"jaw_force_range = [{fitted.lowest!r}, {fitted.highest!r}]",
    ]
    for direction, key, value, low, high in _list_coefficients(result):
        if key == COEFFICIENT_KEYS[0]:
            lines += ["", f"[kinematics.{direction}]"]
        lines.append(f"{key} = {{ value = {value!r}, low = {low!r}, high = {high!r} }}")
    return "\n".join(lines) + "\n"


def _render_plots(result: "PairedFit", pairs: "list[PairedSignals]", times: list[list[float]]) -> str:
    import plotly.graph_objects as go  # slow imports
    from plotly.subplots import make_subplots

    figure = make_subplots(
        rows=len(pairs), cols=2, subplot_titles=[text for pair in pairs for text in (pair.name, "estimate − measured")]
    )
    for row, (pair, time) in enumerate(zip(pairs, times, strict=True), 1):
        every = slice(None, None, -(-len(time) // PLOTTED_SAMPLES))
        estimate = result.drive_map.predict(pair.drive_force, pair.drive_position).force
        for name, force, color in (("measured", pair.jaw_force, "#4477aa"), ("estimate", estimate, "#cc3311")):
            loop = go.Scattergl(
                x=pair.drive_force[every],
                y=force[every],
                name=name,
                legendgroup=name,
                showlegend=row == 1,
                line={"color": color, "width": 1},
            )
            figure.add_trace(loop, row=row, col=1)
        left = go.Scattergl(
            x=time[every], y=(estimate - pair.jaw_force)[every], showlegend=False, line={"color": "#555", "width": 1}
        )
        figure.add_trace(left, row=row, col=2)
        figure.update_yaxes(title_text="jaw force", row=row, col=1)
    figure.update_xaxes(title_text="drive force", row=len(pairs), col=1)
    figure.update_xaxes(title_text="time", row=len(pairs), col=2)
    figure.update_layout(
        title=f"Jaw force from the drive, {date.today()}", template="simple_white", height=160 + 280 * len(pairs)
    )
    return figure.to_html(config={"displaylogo": False})
