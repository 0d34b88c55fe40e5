"""The command line. Exit codes: 0 done, 2 wrong use or configuration, 3 recording, 4 tool, 5 refused, 6 service."""

import json
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import rich.markup
import typer
from rich.console import Console
from rich.table import Table

from app import __version__
from app.learn.command import learn
from app.learn.labels import LearnCommand
from app.progress import ProgressBar
from app.study import command as study
from config.errors import ConfigurationError, GraspwatchError, ToolError
from config.load import choose, holdable, load_library, load_protocol, load_settings, load_tool
from config.schema import Settings, Tool, ToolKind

app = typer.Typer(
    name="graspwatch",
    help="Names the tissue in a laparoscopic grasper while it closes, and shows how near the force is to injuring it. "
    "Research instrument, not a medical device.",
    epilog="Exit codes: 0 done, 2 wrong use or configuration, 3 recording, 4 tool, 5 refused, 6 service.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
errors = Console(stderr=True, highlight=False)
app.add_typer(study.app, name="study")
app.command("learn", cls=LearnCommand)(learn)

LibraryOption = Annotated[
    str | None, typer.Option("--library", metavar="NAME|FILE", help="Tissue library: a name or a file.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of a table.")]
SeedOption = Annotated[int, typer.Option(min=0, help="Of specimens and noise; the same seed gives the same grasps.")]
DataOption = Annotated[
    Path | None,
    typer.Option("--data", metavar="FOLDER", help="Journal, recordings and studies; default: as configured."),
]
RECORDED_WITH = "smart_tool_2013"
ConfigOption = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="Settings instead of config/graspwatch.toml.")
]


@app.callback(invoke_without_command=True)
def version(
    show: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    if show:
        print(__version__)
        raise typer.Exit


@app.command()
def serve(
    tool: Annotated[
        str | None, typer.Option(metavar="NAME|FILE", help="`simulated`, `nidaq` (a real NI board), or a tool file.")
    ] = None,
    tissue: Annotated[str | None, typer.Option(help="What the simulated grasper holds first.")] = None,
    seed: SeedOption = 0,
    host: Annotated[str | None, typer.Option(help="Address to listen on; 0.0.0.0 for the whole network.")] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="Port to listen on; 0 for a free one.")] = None,
    config: ConfigOption = None,
    data: DataOption = None,
    demo: Annotated[bool, typer.Option("--demo", help="Repeat a protocol on each tissue in turn.")] = False,
) -> None:
    """Start the service: dashboard, REST and live stream, with a tool under it.

    Example: graspwatch serve --tissue liver --port 8080
    """
    from app.plan import ServicePlan

    settings = load_settings(config)
    chosen, library = load_tool(tool or settings.tool), load_library(settings.library)
    library.check_tool(chosen)
    if chosen.kind is ToolKind.RECORDING:
        raise ConfigurationError(f"The tool {chosen.name!r} is for recordings. Use `graspwatch replay FILE --serve`.")
    if chosen.kind is not ToolKind.SIMULATED and (tissue or demo):
        raise ConfigurationError("--tissue and --demo are for the simulated grasper; leave them out for a real tool.")
    held = choose(tissue, list(holdable(library).tissues), "tissue") if tissue else next(iter(library.tissues))
    if chosen.kind is ToolKind.NIDAQ:
        from acquisition.nidaq import check_driver

        check_driver(chosen)
    rig = load_tool(RECORDED_WITH)
    _serve(ServicePlan(chosen, library, settings, held, seed, _data_folder(data, settings), rig, demo=demo), host, port)


@app.command()
def run(
    protocol: Annotated[str, typer.Argument(metavar="PROTOCOL", help="A name of config/protocols, or a file.")],
    tissue: Annotated[str, typer.Option(help="What the simulated grasper holds: a tissue of the library.")],
    cycles: Annotated[int | None, typer.Option(min=1, max=10_000, help="Grasps; default: the protocol's.")] = None,
    seed: SeedOption = 0,
    library: LibraryOption = None,
    config: ConfigOption = None,
    real_time: Annotated[bool, typer.Option("--real-time", help="As slow as life, not as fast as it goes.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a protocol on the simulated grasper, without a service, and print what was identified.

    Example: graspwatch run trapezoid_2hz --tissue liver --cycles 5
    """
    settings = load_settings(config)
    profiles, wanted = load_library(library or settings.library), load_protocol(protocol)
    choose(tissue, list(holdable(profiles).tissues), "tissue")
    profiles.check_tool(_simulated_tool(settings))

    from app.headless import run_protocol  # takes a second: not before the request is known to be sound

    count = cycles or wanted.cycles
    duration_s = wanted.lead_in_s + count * wanted.waveform.cycle_s
    with ProgressBar(f"{wanted.name} on {tissue}", duration_s, errors) as progress:
        report = run_protocol(
            _simulated_tool(settings), profiles, settings, wanted, tissue,
            cycles=count, seed=seed, real_time=real_time, progress=progress,
        )  # fmt: skip
    _print_reports([report.document()], as_json)
    if report.failure:
        raise ToolError(report.failure)


@app.command()
def replay(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="LabVIEW recordings: .lvm or .lvm.gz.")],
    library: LibraryOption = None,
    tool: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Tool file with the recording's channels and calibration.")
    ] = RECORDED_WITH,
    speed: Annotated[
        float | None, typer.Option(min=0.01, max=1000, help="Times real time; default: as fast as it goes.")
    ] = None,
    serve_it: Annotated[bool, typer.Option("--serve", help="Watch it in the dashboard, with pause and seek.")] = False,
    host: Annotated[str | None, typer.Option(help="With --serve: address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="With --serve: port to listen on.")] = None,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Take recordings through calibration, conditioning, estimation and identification.

    With one FILE, --json prints one document; with several, a list of them.

    Example: graspwatch replay liver4Hz1.lvm.gz --json
    """
    from acquisition.recording import read_lvm

    settings = load_settings(config)
    profiles, rig = load_library(library or settings.library), load_tool(tool)
    profiles.check_tool(rig)
    for path in files:
        read_lvm(path, rig)

    from app.headless import replay_recording  # takes a second: not before the files are known to be sound
    from app.plan import ServicePlan

    if serve_it:
        if as_json or speed is not None:
            raise ConfigurationError("--serve shows the recording in the dashboard; leave --json and --speed out.")
        held, folder = next(iter(profiles.tissues)), _data_folder(data, settings)
        plan = ServicePlan(rig, profiles, settings, held, 0, folder, rig, tuple(files))
        _serve(plan, host, port)
        return
    documents = []
    for path in files:
        with ProgressBar(path.name, 1.0, errors) as progress:
            documents.append(replay_recording(path, rig, profiles, settings, speed=speed, progress=progress).document())
    _print_reports(documents, as_json)


def _data_folder(wanted: Path | None, settings: Settings) -> Path:
    """The folder for everything that is kept, made where it is missing.

    Raises:
        ConfigurationError: it cannot be made or written to.
    """
    folder = wanted or Path(settings.data_folder)
    try:
        for name in ("recordings", "studies"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigurationError(
            f"{folder}: is no folder to keep data in ({error.strerror}). Name another with --data."
        ) from None
    return folder.resolve()


def _simulated_tool(settings: Settings) -> Tool:
    """The tool that the settings name if it is a simulated one, else the shipped simulated one."""
    named = load_tool(settings.tool)
    return named if named.kind is ToolKind.SIMULATED else load_tool("simulated")


def _serve(plan: Any, host: str | None, port: int | None) -> None:
    from app.main import listen
    from app.main import serve as serve_plan

    server = plan.settings.server
    listener = listen(host or server.host, server.port if port is None else port)
    address, bound = listener.getsockname()[:2]
    shown = "localhost" if address in ("127.0.0.1", "0.0.0.0", "::") else address
    what = f"replay of {', '.join(path.name for path in plan.opened)}" if plan.opened else plan.tool.title
    errors.print(f"Graspwatch {__version__}: {what}. Research instrument, not a medical device.", soft_wrap=True)
    if not plan.opened:
        errors.print(
            "Preparing the filters; the very first start compiles them, which takes up to a minute.", soft_wrap=True
        )
    print(f"Dashboard: http://{shown}:{bound}/  (API: http://{shown}:{bound}/docs)  Ctrl+C ends it.", flush=True)
    serve_plan(plan, listener)


def _print_reports(documents: list[dict[str, Any]], as_json: bool) -> None:
    if as_json:
        print(json.dumps(documents[0] if len(documents) == 1 else documents, indent=2, allow_nan=False))
        return
    console = Console()
    for document in documents:
        console.print(_table(document))


REMARKS = {"unknown": "fits no tissue of the library"}


def _table(document: dict[str, Any]) -> Table:
    title = (
        f"{document['source']}: {document['samples']} samples in {document['duration_s']:.1f} s, "
        f"{document['lost_samples']} lost; library {document['library']}"
    )
    table = Table(title=title)
    for heading in ("Grasp", "Start", "Tissue", "Prob.", "Decided", "Peak"):
        table.add_column(heading, no_wrap=True)
    table.add_column("Remark")
    for grasp in document["grasps"]:
        probability, decided, peak = grasp["probability"], grasp["time_to_decision_s"], grasp["peak_force_n"]
        top, share = max(grasp["probabilities"].items(), key=lambda each: each[1])
        likeliest = f"likeliest: {top.replace('_', ' ')}, {100 * share:.0f} %" if grasp["label"] == "undecided" else ""
        table.add_row(
            str(grasp["index"]),
            f"{grasp['start_s']:.3f} s",
            grasp["label"].replace("_", " "),
            "" if probability is None else f"{probability:.0%}",
            "" if decided is None else f"{decided * 1e3:.0f} ms",
            "" if peak is None else f"{peak:.2f} N",
            grasp["why_invalid"] or REMARKS.get(grasp["label"]) or likeliest,
        )
    return table


def main() -> None:
    """Entry point: every error a user can meet ends with one message and its own exit code."""
    try:
        app()
    except GraspwatchError as error:
        errors.print("[bold red]Error:[/]", rich.markup.escape(str(error)), soft_wrap=True)
        sys.exit(error.exit_code)
    except BrokenPipeError:
        sys.exit(0)


if __name__ == "__main__":
    main()
