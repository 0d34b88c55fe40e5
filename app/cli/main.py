"""The `graspwatch` command: `serve`, `run`, `replay`, `index`, and the registration of the other commands."""

import contextlib
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from app import __version__
from app.cli import audit, calibrate, exchange, study
from app.cli import token as people
from app.cli.bench import bench
from app.cli.check import check
from app.cli.console import accept_any_name, create_console, error_console, print_error, print_note
from app.cli.label_option import LabelCommand, LearnCommand
from app.cli.learn import learn
from app.cli.options import (
    DEFAULT_RECORDING_TOOL,
    ConfigOption,
    DataOption,
    JsonOption,
    LibraryOption,
    ProgressBar,
    SeedOption,
    TlsCertOption,
    TlsKeyOption,
    ToolOption,
    prepare_data_folder,
)
from app.cli.report import report
from app.cli.support import support
from config.errors import ConfigurationError, GraspwatchError, ToolError
from config.load import (
    build_graspable_library,
    load_grasp_protocol,
    load_library,
    load_settings,
    load_tool,
    require_known_name,
)
from config.network import format_host
from config.schema import FoxgloveSettings, Settings, Tool, ToolKind

if TYPE_CHECKING:
    from config.service_plan import ServicePlan

app = typer.Typer(
    name="graspwatch",
    help="Names the tissue in a laparoscopic grasper while it closes, and shows how near the force is to injuring it. "
    "Research instrument, not a medical device.",
    epilog="Exit codes: 0 done, 2 wrong use or configuration, 3 recording, 4 tool, 5 refused, 6 service, 7 journal, "
    "8 calibration.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(study.app, name="study")
app.add_typer(audit.app, name="audit")
app.add_typer(people.app, name="token")
app.add_typer(calibrate.app, name="calibrate")
for command in (*exchange.COMMANDS, check, bench, support):
    app.command(command.__name__.strip("_").replace("_", "-"))(command)
app.command("report", cls=LabelCommand)(report)
app.command("learn", cls=LearnCommand)(learn)


@app.callback(invoke_without_command=True)
def version(
    show_version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    if show_version:
        print(__version__)
        raise typer.Exit


@app.command()
def serve(
    tool: ToolOption = None,
    tissue: Annotated[str | None, typer.Option(help="What the simulated grasper holds first.")] = None,
    seed: SeedOption = 0,
    host: Annotated[str | None, typer.Option(help="Address to listen on; 0.0.0.0 for the whole network.")] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="Port to listen on; 0 for a free one.")] = None,
    tls_cert: TlsCertOption = None,
    tls_key: TlsKeyOption = None,
    config: ConfigOption = None,
    data: DataOption = None,
    demo: Annotated[bool, typer.Option("--demo", help="Repeat a protocol on each tissue in turn.")] = False,
    foxglove: Annotated[
        int | None,
        typer.Option(min=1, max=65535, metavar="PORT", help="Stream to this computer's Foxglove or Lichtblick, too."),
    ] = None,
) -> None:
    """Start the service: dashboard, REST and live stream, with a tool under it.

    Example: graspwatch serve --tissue liver --port 8080
    """
    from config.service_plan import ServicePlan

    settings = load_settings(config)
    chosen, library = load_tool(tool or settings.tool), load_library(settings.library)
    library.check_tool(chosen)
    if chosen.kind is ToolKind.RECORDING:
        raise ConfigurationError(f"The tool {chosen.name!r} is for recordings. Use `graspwatch replay FILE --serve`.")
    if chosen.kind is not ToolKind.SIMULATED and (tissue or demo):
        raise ConfigurationError("--tissue and --demo are for the simulated grasper; leave them out for a real tool.")
    held = (
        require_known_name(tissue, list(build_graspable_library(library).tissues), "tissue")
        if tissue
        else next(iter(library.tissues))
    )
    if chosen.kind is ToolKind.NIDAQ:
        from acquisition.drivers.nidaq import read_driver_version

        read_driver_version(chosen)
    context = load_tool(DEFAULT_RECORDING_TOOL)
    settings = _apply_tls_options(settings, tls_cert, tls_key)
    if foxglove:
        settings = settings.model_copy(update={"foxglove": FoxgloveSettings(port=foxglove)})
    folder, source = prepare_data_folder(data, settings), tool or settings.tool
    _start_server(
        ServicePlan(chosen, library, settings, held, seed, folder, context, demo_enabled=demo, tool_source=source),
        host,
        port,
    )


@app.command()
def run(
    protocol: Annotated[str, typer.Argument(metavar="PROTOCOL", help="A name of config/protocols, or a file.")],
    tissue: Annotated[str, typer.Option(help="What the simulated grasper holds: a tissue of the library.")],
    cycles: Annotated[int | None, typer.Option(min=1, max=10_000, help="Grasps; default: the protocol's.")] = None,
    seed: SeedOption = 0,
    library: LibraryOption = None,
    config: ConfigOption = None,
    real_time: Annotated[bool, typer.Option("--real-time", help="As slow as life, not as fast as it goes.")] = False,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE.mcap", help="Write all of it to a new file, to be replayed.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run a protocol on the simulated grasper, without a service, and print what was identified.

    Example: graspwatch run trapezoid_2hz --tissue liver --cycles 5
    """
    settings = load_settings(config)
    profiles, wanted = load_library(library or settings.library), load_grasp_protocol(protocol)
    require_known_name(tissue, list(build_graspable_library(profiles).tissues), "tissue")
    profiles.check_tool(_simulated_tool(settings))

    from app.analysis.headless import run_protocol  # a slow import, made after the options are checked

    count = cycles or wanted.cycles
    duration_s = wanted.lead_in_s + count * wanted.waveform.cycle_s
    with ProgressBar(f"{wanted.name} on {tissue}", duration_s) as progress:
        report = run_protocol(
            _simulated_tool(settings),
            profiles,
            settings,
            wanted,
            tissue,
            cycles=count,
            seed=seed,
            real_time=real_time,
            recording_path=record,
            progress=progress,
        )
    _print_reports([report.document()], as_json)
    for text in report.releases:
        error_console.print(text, soft_wrap=True)
    if report.failure:
        raise ToolError(report.failure)


@app.command()
def replay(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Recordings: .mcap, or LabVIEW's .lvm, .lvm.gz.")],
    library: LibraryOption = None,
    tool: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Tool file with channels and calibration; default: the one in an .mcap file, for LabVIEW's "
            f"{DEFAULT_RECORDING_TOOL}.",
        ),
    ] = None,
    as_recorded: Annotated[
        bool, typer.Option("--as-recorded", help="With the library and the settings that stand in the .mcap file.")
    ] = False,
    speed: Annotated[
        float | None, typer.Option(min=0.01, max=1000, help="Times real time; default: as fast as it goes.")
    ] = None,
    serve_dashboard: Annotated[
        bool, typer.Option("--serve", help="Watch it in the dashboard, with pause and seek.")
    ] = False,
    host: Annotated[str | None, typer.Option(help="With --serve: address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="With --serve: port to listen on.")] = None,
    tls_cert: TlsCertOption = None,
    tls_key: TlsKeyOption = None,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Take recordings through calibration, conditioning, estimation and identification.

    Of an .mcap file the estimates are compared with those recorded, and what differs is said. With one FILE, --json
    prints one document; with several, a list of them.

    Example: graspwatch replay liver4Hz1.lvm.gz --json
    """
    from acquisition.recordings.recording import RecordingSource

    settings = load_settings(config)
    profiles, context = load_library(library or settings.library), load_tool(tool or DEFAULT_RECORDING_TOOL)
    if as_recorded and (library or config or serve_dashboard):
        raise ConfigurationError("--as-recorded takes library and settings from the file; leave the others out.")
    for path in files:
        profiles.check_tool(context if tool else RecordingSource(path, context).tool)

    from app.analysis.headless import replay_recording  # a slow import, made after the files are checked
    from app.recordings.mcap_writer import RecordingContext
    from config.service_plan import ServicePlan

    if serve_dashboard:
        if as_json or speed is not None:
            raise ConfigurationError("--serve shows the recording in the dashboard; leave --json and --speed out.")
        settings = _apply_tls_options(settings, tls_cert, tls_key)
        held, folder = next(iter(profiles.tissues)), prepare_data_folder(data, settings)
        plan = ServicePlan(context, profiles, settings, held, 0, folder, context, tuple(files))
        _start_server(plan, host, port)
        return
    documents = []
    for path in files:
        recording = RecordingSource(path, context, speed)
        how = RecordingContext(context if tool else recording.tool, profiles, settings)
        if as_recorded:
            if recording.mcap_file is None:
                raise ConfigurationError(f"{path}: LabVIEW's files hold no library. Leave --as-recorded out.")
            how = RecordingContext.from_recording(recording.mcap_file)
        for remark in recording.remarks:
            print_note(f"{path}: {remark}.")
        with ProgressBar(path.name, 1.0) as progress:
            report = replay_recording(recording, how, progress)
        documents.append(report.document())
        if report.comparison:
            error_console.print(report.comparison.text(), soft_wrap=True)
    _print_reports(documents, as_json)


@app.command()
def index(
    rebuild: Annotated[
        bool, typer.Option("--rebuild", help="Build it anew from the recordings and the journal.")
    ] = False,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Tell what the index of runs holds and lacks, or build it anew. The old one is set aside, never deleted.

    Example: graspwatch index --rebuild --data graspwatch-data
    """
    from app.cli import index as command
    from app.index.database import index_url_from_settings

    settings = load_settings(config)
    folder = prepare_data_folder(data, settings)
    url = index_url_from_settings(settings, folder)
    if not rebuild:
        command.print_status(url, folder, as_json)
        return
    if as_json:
        raise ConfigurationError("--json tells what the index holds; leave it out with --rebuild.")
    with ProgressBar("Rebuilding the index", 1.0) as progress:
        command.rebuild_and_report(url, folder, error_console, progress)


def _simulated_tool(settings: Settings) -> Tool:
    """Return the tool that the settings name if it is simulated, else the shipped simulated tool."""
    named = load_tool(settings.tool)
    return named if named.kind is ToolKind.SIMULATED else load_tool("simulated")


def _apply_tls_options(settings: Settings, cert: Path | None, key: Path | None) -> Settings:
    changes = {name: str(path) for name, path in (("tls_cert", cert), ("tls_key", key)) if path}
    return settings.model_copy(update={"server": settings.server.model_copy(update=changes)})


def _start_server(plan: "ServicePlan", host: str | None, port: int | None) -> None:
    from app.api.app import create_app, open_listener
    from app.api.app import serve as serve_app
    from app.people.bind_check import check_certificate, check_listen_address

    server = plan.settings.server
    check_certificate(server.tls_cert, server.tls_key)
    with contextlib.ExitStack() as unless_served:
        listener = unless_served.enter_context(
            open_listener(host or server.host, server.port if port is None else port)
        )
        address, bound = listener.getsockname()[:2]
        stream_port = None if plan.opened_recordings else plan.settings.foxglove.port
        if stream_port:
            from app.service.foxglove_worker import HOST

            open_listener(HOST, stream_port).close()  # fails now, not in the worker, if the port is taken
        warning = check_listen_address(address, plan.data_folder, server.tls_cert is not None)
        application = create_app(plan)
        unless_served.pop_all()
    scheme = "https" if server.tls_cert else "http"
    shown = "localhost" if address in ("127.0.0.1", "0.0.0.0", "::") else format_host(address)
    names = ", ".join(path.name for path in plan.opened_recordings)
    what = f"replay of {names}" if names else plan.tool.title
    error_console.print(f"Graspwatch {__version__}: {what}. Research instrument, not a medical device.", soft_wrap=True)
    if not plan.opened_recordings:
        error_console.print(
            "Preparing the filters; the very first start compiles them, which takes up to a minute.", soft_wrap=True
        )
    if warning:
        error_console.print(warning, style="yellow", soft_wrap=True)
    url = f"{scheme}://{shown}:{bound}"
    stream = f"  (Foxglove: ws://localhost:{stream_port})" if stream_port else ""
    print(f"Dashboard: {url}/  (API: {url}/docs){stream}  Ctrl+C ends it.", flush=True)
    serve_app(application, listener, plan)


def _print_reports(documents: list[dict[str, Any]], as_json: bool) -> None:
    if as_json:
        print(json.dumps(documents[0] if len(documents) == 1 else documents, indent=2, allow_nan=False))
        return
    console = create_console()
    for document in documents:
        console.print(_build_table(document))


VERDICT_REMARKS = {"unknown": "fits no tissue of the library"}


def _build_table(document: dict[str, Any]) -> Table:
    title = (
        f"{document['source']}: {document['samples']} samples in {document['duration_s']:.1f} s, "
        f"{document['lost_samples']} lost; library {document['library']}; {document['force_scale']}"
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
            grasp["why_invalid"] or VERDICT_REMARKS.get(grasp["label"]) or likeliest,
        )
    return table


def main() -> None:
    """Run the command line; print an expected error as one message, and exit with its code."""
    accept_any_name()
    try:
        app()
    except GraspwatchError as error:
        print_error(str(error))
        sys.exit(error.exit_code)
    except BrokenPipeError:
        sys.exit(0)


if __name__ == "__main__":
    main()
