"""`graspwatch run`: a protocol on the simulated grasper, without a service."""

from pathlib import Path
from typing import Annotated

import typer

from app.cli.console import error_console
from app.cli.grasp_table import print_reports
from app.cli.options import (
    ConfigOption,
    DataOption,
    JsonOption,
    LibraryOption,
    ProgressBar,
    SeedOption,
    locate_data_folder,
)
from config.errors import ConfigurationError, ToolError
from config.load import (
    build_graspable_library,
    load_grasp_protocol,
    load_library,
    load_settings,
    load_tool,
    require_known_name,
)
from config.schema import Settings, Tool, ToolKind


def run(
    protocol: Annotated[str, typer.Argument(metavar="PROTOCOL", help="A shipped protocol, an own one, or a file.")],
    tissue: Annotated[
        str | None,
        typer.Option(
            help="What the simulated grasper holds: a tissue of the library. `reference_grasp` alone needs none."
        ),
    ] = None,
    cycles: Annotated[int | None, typer.Option(min=1, max=10_000, help="Grasps; default: the protocol's.")] = None,
    seed: SeedOption = 0,
    library: LibraryOption = None,
    config: ConfigOption = None,
    data: DataOption = None,
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
    own = locate_data_folder(data, settings)
    profiles, wanted = load_library(library or settings.library, own), load_grasp_protocol(protocol, own)
    simulated = _simulated_tool(settings, own)
    if wanted.is_reference_grasp and tissue:
        raise ConfigurationError("A reference grasp closes on nothing. Leave --tissue out.")
    if not (wanted.is_reference_grasp or tissue):
        raise ConfigurationError(
            f"Name what {wanted.name} grasps: --tissue NAME, one of {', '.join(profiles.tissues)}."
        )
    if tissue:
        require_known_name(tissue, list(build_graspable_library(profiles).tissues), "tissue")
    profiles.check_tool(simulated)

    from app.analysis.headless import run_protocol  # a slow import, made after the options are checked

    count = cycles or wanted.cycles
    duration_s = wanted.lead_in_s + count * wanted.waveform.cycle_s
    with ProgressBar(f"{wanted.name} on {tissue or 'empty jaws'}", duration_s) as progress:
        report = run_protocol(
            simulated,
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
    print_reports([report.document()], as_json)
    for text in report.releases:
        error_console.print(text, soft_wrap=True)
    if report.failure:
        raise ToolError(report.failure)


def _simulated_tool(settings: Settings, data_folder: Path) -> Tool:
    """Return the tool that the settings name if it is simulated, else the shipped simulated tool."""
    named = load_tool(settings.tool, data_folder)
    return named if named.kind is ToolKind.SIMULATED else load_tool("simulated")
