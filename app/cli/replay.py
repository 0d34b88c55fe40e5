"""`graspwatch replay`: recordings through the estimator, or in the dashboard."""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from app.cli.console import error_console, print_note
from app.cli.grasp_table import print_reports
from app.cli.options import (
    DEFAULT_RECORDING_TOOL,
    ConfigOption,
    DataOption,
    JsonOption,
    LibraryOption,
    ProgressBar,
    TlsCertOption,
    TlsKeyOption,
    find_data_folder,
    locate_data_folder,
    prepare_known_data_folder,
)
from app.cli.server import apply_tls_options, start_server
from app.people.tokens import TOKEN_FILE
from config.errors import ConfigurationError, GraspwatchError
from config.load import load_library, load_settings, load_tool
from config.schema import Settings


def replay(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="Recordings: .mcap, LabVIEW's .lvm, .lvm.gz, or tables.")
    ],
    library: LibraryOption = None,
    tool: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Tool file with channels and calibration; default: the one in an .mcap file, for others "
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
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Recording with empty jaws of the same day and tool: the zero of stall and stops."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Take recordings through calibration, conditioning, estimation and identification.

    Of an .mcap file the estimates are compared with those recorded, and what differs is said. With one FILE, --json
    prints one document; with several, a list of them.

    Example: graspwatch replay liver4Hz1.lvm.gz --json
    """
    from acquisition.recordings.recording import RecordingSource

    settings = load_settings(config)
    own = locate_data_folder(data, settings)
    profiles, context = (load_library(library or settings.library, own), load_tool(tool or DEFAULT_RECORDING_TOOL, own))
    if as_recorded and (library or config or serve_dashboard):
        raise ConfigurationError("--as-recorded takes library and settings from the file; leave the others out.")
    for path in files:
        profiles.check_tool(context if tool else RecordingSource(path, context).tool)

    from app.analysis.headless import replay_recording  # a slow import, made after the files are checked
    from app.analysis.learning.grasp_reader import check_reference_day, read_reference
    from app.recordings.mcap_writer import RecordingContext
    from config.service_plan import ServicePlan

    if serve_dashboard:
        if as_json or speed is not None or reference:
            raise ConfigurationError(
                "--serve shows the recording in the dashboard; leave --json, --speed and --reference out."
            )
        settings = apply_tls_options(settings, tls_cert, tls_key)
        held = next(iter(profiles.tissues))
        with _open_data_folder(data, settings) as folder:
            plan = ServicePlan(context, profiles, settings, held, 0, folder, context, tuple(files))
            start_server(plan, host, port)
        return
    documents = []
    for path in files:
        recording = RecordingSource(path, context, speed)
        how = RecordingContext(context if tool else recording.tool, profiles, settings)
        if as_recorded:
            if recording.mcap_file is None:
                raise ConfigurationError(f"{path}: only .mcap files hold a library. Leave --as-recorded out.")
            how = RecordingContext.from_recording(recording.mcap_file)
        for remark in recording.remarks:
            print_note(f"{path}: {remark}.")
        taken = read_reference(reference, how.tool, settings) if reference else None
        if taken:
            check_reference_day(taken, recording)
        with ProgressBar(path.name, 1.0) as progress:
            report = replay_recording(recording, how, progress, taken)
        documents.append(report.document())
        if report.comparison:
            error_console.print(report.comparison.text(), soft_wrap=True)
    print_reports(documents, as_json)


@contextlib.contextmanager
def _open_data_folder(data: Path | None, settings: Settings) -> Iterator[Path]:
    """Yield the data folder, or a temporary one with its tokens if it cannot be written to.

    Raises:
        ConfigurationError: `data` is not there.
    """
    known = find_data_folder(data, settings) if data else locate_data_folder(data, settings)
    try:
        folder = prepare_known_data_folder(data, settings)
    except GraspwatchError as error:
        print_note(f"{error} What this replay writes is kept in a temporary folder until its end.")
        with tempfile.TemporaryDirectory(prefix="graspwatch-") as temporary:
            if (known / TOKEN_FILE).exists():  # who needs a token there needs it here, too
                shutil.copy2(known / TOKEN_FILE, temporary)
            yield Path(temporary)
    else:
        yield folder
