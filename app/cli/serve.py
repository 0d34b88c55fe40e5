"""`graspwatch serve`: the service with a tool under it."""

from typing import Annotated

import typer

from app.cli.options import (
    DEFAULT_RECORDING_TOOL,
    ConfigOption,
    DataOption,
    SeedOption,
    TlsCertOption,
    TlsKeyOption,
    ToolOption,
    locate_data_folder,
    prepare_data_folder,
)
from app.cli.server import apply_tls_options, start_server
from config.errors import ConfigurationError
from config.load import (
    FileKind,
    build_graspable_library,
    find_file,
    load_library,
    load_settings,
    load_tool,
    require_known_name,
)
from config.schema import FoxgloveSettings, ToolKind


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
    own, named = locate_data_folder(data, settings), tool or settings.tool
    chosen, library = load_tool(named, own), load_library(settings.library, own)
    library.check_tool(chosen)
    if chosen.kind is ToolKind.RECORDING:
        raise ConfigurationError(f"The tool {chosen.name!r} is for recordings. Use `graspwatch replay FILE --serve`.")
    if chosen.kind is not ToolKind.SIMULATED and (tissue or demo):
        raise ConfigurationError("--tissue and --demo are for the simulated grasper; leave them out for a real tool.")
    if chosen.kind is not ToolKind.SIMULATED:
        from app.service.library_approvals import LibraryApprovals

        LibraryApprovals(own).check(find_file(settings.library, FileKind.LIBRARY, own), settings.library)
    held = (
        require_known_name(tissue, list(build_graspable_library(library).tissues), "tissue")
        if tissue
        else next(iter(library.tissues))
    )
    if chosen.kind is ToolKind.SERIAL and chosen.table:
        from acquisition.table_columns import find_factors

        find_factors(chosen.table, chosen)
    if chosen.kind is ToolKind.NIDAQ:
        from acquisition.drivers.nidaq import read_driver_version

        read_driver_version(chosen)
    context = load_tool(DEFAULT_RECORDING_TOOL)
    settings = apply_tls_options(settings, tls_cert, tls_key)
    if foxglove:
        settings = settings.model_copy(update={"foxglove": FoxgloveSettings(port=foxglove)})
    folder, source = prepare_data_folder(data, settings), str(find_file(named, FileKind.TOOL, own))
    start_server(
        ServicePlan(chosen, library, settings, held, seed, folder, context, demo_enabled=demo, tool_source=source),
        host,
        port,
    )
