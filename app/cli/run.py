"""`graspwatch run`: a protocol on the simulated grasper, without a service."""

from pathlib import Path
from typing import Annotated

import typer

from app.cli.console import error_console
from app.cli.grasp_table import print_reports
from app.cli.options import ConfigOption, JsonOption, LibraryOption, ProgressBar, SeedOption
from config.errors import ToolError
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
    print_reports([report.document()], as_json)
    for text in report.releases:
        error_console.print(text, soft_wrap=True)
    if report.failure:
        raise ToolError(report.failure)


def _simulated_tool(settings: Settings) -> Tool:
    """Return the tool that the settings name if it is simulated, else the shipped simulated tool."""
    named = load_tool(settings.tool)
    return named if named.kind is ToolKind.SIMULATED else load_tool("simulated")
