"""`graspwatch calibrate`: measurement of a tool's constants at the bench, written to a new, dated tool file."""

import json
from collections.abc import Callable
from dataclasses import asdict
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from app.cli.calibrate_fit import fit
from app.cli.console import create_console, error_console
from app.cli.options import (
    DEFAULT_RECORDING_TOOL,
    ConfigOption,
    DataOption,
    JsonOption,
    ToolOption,
    locate_data_folder,
    write_output,
)
from app.host.computer_user import computer_user_name
from config.errors import CalibrationError, ConfigurationError, GraspwatchError, ToolError
from config.load import FileKind, find_file, list_shipped_names, load_settings, load_tool
from config.schema import Tool

if TYPE_CHECKING:
    from acquisition.bench.calibration_bench import CalibrationBench
    from acquisition.bench.fits import CalibrationFit, FittedConstant

app = typer.Typer(
    help="Measure a tool's constants without tissue. Each command fits them with their confidence intervals, refuses a "
    "fit that cannot be trusted, and writes a new tool file with the day in its name; the old one stays.",
    no_args_is_help=True,
)
app.command()(fit)
T = TypeVar("T")

PersonOption = Annotated[str | None, typer.Option(help="Who calibrates; default: this computer's user.")]
ValidDaysOption = Annotated[
    int, typer.Option("--valid-days", min=1, max=3650, help="From when on a new one is asked for.")
]
OutputFolderOption = Annotated[
    Path | None,
    typer.Option(
        "--into",
        metavar="FOLDER",
        help="Where the new file goes; default: beside the tool's file, or here for a shipped tool.",
    ),
]
YesOption = Annotated[bool, typer.Option("--yes", help="All is prepared: ask nothing. The jaws may move.")]
EMPTY_JAWS_QUESTION = "The jaws will close with half a volt. Are they empty, is nobody near them, and may they move?"


class _CommandLineCalibration:
    """One calibration on the command line: questions, readings, and the output of the fit."""

    def __init__(
        self,
        tool: str | None,
        config: Path | None,
        data: Path | None,
        person: str | None,
        valid_days: int,
        folder: Path | None,
        yes: bool,
        as_json: bool,
        default_tool: str | None = None,
    ) -> None:
        settings = load_settings(config)
        own = locate_data_folder(data, settings)
        named = tool or default_tool or settings.tool
        self.tool: Tool = load_tool(named, own)
        file = find_file(named, FileKind.TOOL, own)
        self._tool_source = str(file)
        self._person, self._valid_days = person or computer_user_name(), valid_days
        shipped = named in list_shipped_names(FileKind.TOOL.folder)
        self._folder = folder or (Path() if shipped else file.parent)
        self._assume_yes, self._as_json = yes, as_json
        if not (yes or error_console.is_terminal):
            raise ConfigurationError("Nobody is at a terminal to answer: prepare all, then say so with --yes.")
        from config.writing import check_writable  # a slow import

        check_writable(self._folder)

    def open_bench(self) -> "CalibrationBench":
        """Open the tool for measuring."""
        if not self.tool.has_motor:
            raise ConfigurationError(
                f"The tool {self.tool.name!r} {self.tool.why_no_motor}: name the one to calibrate with --tool."
            )
        from acquisition.tool_factory import open_calibration_bench
        from acquisition.worker import REALTIME_PRIORITY
        from acquisition.worker_process import hold_realtime_priority  # slow imports

        # The bench reads with the worker's priority.
        return open_calibration_bench(self.tool, partial(hold_realtime_priority, REALTIME_PRIORITY))

    def print_message(self, text: str) -> None:
        error_console.print(text, soft_wrap=True)

    def confirm(self, question: str) -> None:
        """Ask the person at the terminal unless `--yes` was given; raises `CalibrationError` if they decline."""
        if not self._assume_yes and not typer.confirm(question, default=True, err=True):
            raise CalibrationError("Broken off. Nothing was written.")

    def read_with_retry(self, measure: Callable[[], T]) -> T:
        """Take one reading; if it fails, offer the person at the terminal to repeat it."""
        while True:
            try:
                return measure()
            except (CalibrationError, ToolError) as error:
                if self._assume_yes:
                    raise
                error_console.print(str(error), style="red", soft_wrap=True)
                if not typer.confirm("Read it again?", default=True, err=True):
                    raise

    def read_each(
        self,
        values: list[float],
        question: Callable[[float], str],
        measure: Callable[[float], T],
        format_reading: Callable[[float, T], str],
    ) -> list[T]:
        """Take a reading for each weight or gauge, one after the other."""
        found = []
        for n, value in enumerate(values, 1):
            self.confirm(f"{n} of {len(values)}: {question(value)}")
            found.append(self.read_with_retry(partial(measure, value)))
            self.print_message(format_reading(value, found[-1]))
        return found

    def finish(self, fit: "Callable[[], CalibrationFit]") -> None:
        """Fit the constants, write the new tool file with its plot, and print the result."""
        try:
            found = fit()
        except CalibrationError as error:
            raise CalibrationError(f"{error} Nothing was written.") from None
        from acquisition.bench.calibration_file import write_calibration_file
        from acquisition.bench.fits import read_current_value  # slow imports

        path = write_calibration_file(found, self._tool_source, self._person, self._valid_days, self._folder)
        plot = path.with_suffix(".html")
        names = ", ".join(each.key.partition(".")[2] for each in found.constants)
        title = f"{self.tool.title}: {names}, {date.today()}"
        try:
            write_output(plot, _render_plot_page(found, title), "--into")
        except GraspwatchError as error:
            raise type(error)(f"The tool file {path} is written, its plot is not: {error}") from None
        if self._as_json:
            constants = [asdict(each) | {"was": read_current_value(each, self.tool)} for each in found.constants]
            print(json.dumps({"file": str(path), "plot": str(plot), "constants": constants}, indent=2))
            return
        console = create_console()
        for each in found.constants:
            console.print(self._format_constant(each), soft_wrap=True)
        for remark in found.remarks:
            console.print(remark, style="yellow", soft_wrap=True)
        console.print(f"Written: {path}, its plot: {plot}. Use it with --tool {path}", soft_wrap=True)

    def _format_constant(self, constant: "FittedConstant") -> str:
        from acquisition.bench.fits import read_current_value

        unit, old = constant.unit, read_current_value(constant, self.tool)
        was = f"was {old:.5g}" if old is not None else "was not given"
        return (
            f"{constant.key} {constant.value:.5g} {unit} (95 %: {constant.low:.5g} to {constant.high:.5g}), "
            f"{was}; residual {constant.residual:.2g} {constant.residual_unit}, {constant.readings} readings"
        )


@app.command()
def tare(
    tool: ToolOption = None,
    person: PersonOption = None,
    days: ValidDaysOption = 90,
    into: OutputFolderOption = None,
    yes: YesOption = False,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Rest voltage of the strain gage and its noise: ten seconds with the jaws open and nothing on the tool.

    Example: graspwatch calibrate tare --tool nidaq
    """
    session = _CommandLineCalibration(tool, config, data, person, days, into, yes, as_json)
    bench = session.open_bench()
    session.confirm("Are the jaws open and empty, does nothing pull on the tool, and is the amplifier warm?")
    from acquisition.bench import fits

    rest = session.read_with_retry(bench.read_at_rest)
    session.finish(lambda: fits.fit_tare(rest, session.tool))


@app.command()
def strain(
    weights: Annotated[
        str, typer.Option(metavar="N,N,…", help="Pulls on the handle in the order of their hanging, newtons.")
    ] = "0,2,4,6,8,10,5,0",
    tool: ToolOption = None,
    person: PersonOption = None,
    days: ValidDaysOption = 90,
    into: OutputFolderOption = None,
    yes: YesOption = False,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Gain of the strain gage, Eq. (1), from known weights on the handle: 1 kg pulls with 9.81 N.

    Example: graspwatch calibrate strain --tool nidaq --weights 0,2,4,6,8,10,5,0
    """
    from acquisition.bench import fits

    session = _CommandLineCalibration(tool, config, data, person, days, into, yes, as_json)
    fits.check_has_linkage(session.tool, "strain")
    pulls_n = fits.check_pulls(_parse_numbers(weights, "--weights"))
    bench = session.open_bench()

    def measure(pull_n: float) -> "fits.RawSignals":
        reading = bench.read_under_pull(pull_n)
        fits.check_steady(reading, f"{pull_n:g} N", session.tool)
        return reading

    readings = session.read_each(
        pulls_n.tolist(),
        lambda pull_n: f"does {f'a pull of {pull_n:g} N' if pull_n else 'nothing'} hang, at rest?",
        measure,
        lambda pull_n, reading: f"{pull_n:>8g} N  {reading.strain_v.mean():9.4f} V",
    )
    session.finish(lambda: fits.fit_strain(pulls_n, readings, session.tool))


@app.command()
def force(
    forces: Annotated[
        str,
        typer.Option(metavar="N,N,…", help="Forces on a load cell between the jaws in their order, newtons; first 0."),
    ] = "0,1,2,3,4,5,3,1",
    load_cell_error: Annotated[
        float,
        typer.Option(min=0.0, max=20.0, help="Error of the load cell, percent of its reading. It widens the interval."),
    ] = 1.0,
    tool: ToolOption = None,
    person: PersonOption = None,
    days: ValidDaysOption = 90,
    into: OutputFolderOption = None,
    yes: YesOption = False,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Force scale, by the law of the tool file, from a load cell between the jaws; the motor stays at zero.

    Calibrate strain, stretch and geometry before. A real tool is armed only with a measured force scale.

    Example: graspwatch calibrate force --tool nidaq --forces 0,1,2,3,4,5,3,1
    """
    from acquisition.bench import fits

    session = _CommandLineCalibration(tool, config, data, person, days, into, yes, as_json)
    known_n = fits.check_jaw_forces(_parse_numbers(forces, "--forces"))
    bench = session.open_bench()

    def measure(force_n: float) -> "fits.RawSignals":
        reading = bench.read_under_jaw_force(force_n)
        fits.check_steady(reading, f"{force_n:g} N", session.tool)
        return reading

    def question(force_n: float) -> str:
        if not force_n:
            return "are the jaws open, and does nothing pull on the handle?"
        return f"is the handle pulled until the load cell between the jaws shows {force_n:g} N, and held there?"

    readings = session.read_each(
        known_n.tolist(),
        question,
        measure,
        lambda force_n, reading: f"{force_n:>8g} N  {reading.strain_v.mean():9.4f} V",
    )
    session.finish(lambda: fits.fit_force_scale(known_n, readings, session.tool, load_cell_error / 100))


@app.command()
def stretch(
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE]…", help="Recordings whose jaws shut, instead of moving a tool."),
    ] = None,
    tool: ToolOption = None,
    person: PersonOption = None,
    days: ValidDaysOption = 90,
    into: OutputFolderOption = None,
    yes: YesOption = False,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Stretch of the cable, Eq. (3): empty jaws are shut gently, with a force that rises and falls.

    Examples: graspwatch calibrate stretch --tool nidaq; graspwatch calibrate stretch liver4Hz1.lvm.gz --yes
    """
    from acquisition.bench import fits

    session = _CommandLineCalibration(
        tool,
        config,
        data,
        person,
        days,
        into,
        yes or bool(recordings),
        as_json,
        DEFAULT_RECORDING_TOOL if recordings else None,
    )
    fits.check_has_linkage(session.tool, "stretch")
    if recordings:
        from acquisition.bench.calibration_bench import extract_recorded_force_passes
        from acquisition.recordings.recording import RecordingSource

        passes = []
        for path in recordings:
            recording = RecordingSource(path, session.tool)
            for remark in recording.remarks:
                session.print_message(f"{path}: {remark}.")
            passes += extract_recorded_force_passes(recording)
    else:
        bench = session.open_bench()
        session.confirm(EMPTY_JAWS_QUESTION)
        passes = session.read_with_retry(bench.sweep_force_on_empty_jaws)
    session.finish(lambda: fits.fit_cable_stretch(passes, session.tool))


@app.command()
def geometry(
    gauges: Annotated[
        str, typer.Option(metavar="MM,MM,…", help="Thickness of the gauges between the jaws, mm; 0: none.")
    ] = "0,2,4,6,8",
    tool: ToolOption = None,
    person: PersonOption = None,
    days: ValidDaysOption = 90,
    into: OutputFolderOption = None,
    yes: YesOption = False,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Zero of the encoder (the opening of the jaws) and its ratio to the handle, Eqs. (4) to (6), from gauges.

    Calibrate the stretch before: it is taken out of the angles.

    Example: graspwatch calibrate geometry --tool nidaq --gauges 0,2,4,6,8
    """
    from acquisition.bench import fits

    session = _CommandLineCalibration(tool, config, data, person, days, into, yes, as_json)
    fits.check_has_linkage(session.tool, "geometry")
    gauges_m = fits.check_gauges([each * 1e-3 for each in _parse_numbers(gauges, "--gauges")])

    def question(gauge_m: float) -> str:
        what = f"the gauge of {gauge_m * 1e3:g} mm between the jaws" if gauge_m else "nothing between the jaws"
        return f"is {what}, is nobody near them, and may they close with half a volt?"

    passes = session.read_each(
        gauges_m.tolist(),
        question,
        session.open_bench().sweep_force_on_gauge,
        lambda gauge_m, found: f"{gauge_m * 1e3:>8g} mm  {found.encoder_deg.mean():9.1f} degrees",
    )
    session.finish(lambda: fits.fit_geometry(gauges_m, passes, session.tool))


def _parse_numbers(text: str, option: str) -> list[float]:
    try:
        return [float(each) for each in text.split(",")]
    except ValueError:
        raise ConfigurationError(f"{option} takes numbers with commas between, like 0,2,4,6; found: {text}") from None


def _render_plot_page(fit: "CalibrationFit", title: str) -> str:
    import plotly.graph_objects as go  # a slow import

    (x, y), (line_x, line_y) = fit.points, fit.line
    figure = go.Figure(
        [
            go.Scatter(x=x, y=y, mode="markers", name="readings"),
            go.Scatter(x=line_x, y=line_y, mode="lines", name="fit"),
        ]
    )
    figure.update_layout(title=title, xaxis_title=fit.axes[0], yaxis_title=fit.axes[1], template="simple_white")
    return figure.to_html(config={"displaylogo": False})
