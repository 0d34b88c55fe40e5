"""`graspwatch import`: LabVIEW logs into the data folder."""

from pathlib import Path
from typing import Annotated

import typer

from app.cli.journaled import journal_local_command
from app.cli.options import (
    DEFAULT_RECORDING_TOOL,
    ConfigOption,
    DataOption,
    LibraryOption,
    ProgressBar,
    prepare_data_folder,
)
from config.load import load_library, load_settings, load_tool


def import_(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="LabVIEW logs: .lvm, .lvm.gz.")],
    tool: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Tool file that names the channels and their calibration.")
    ] = DEFAULT_RECORDING_TOOL,
    tissue: Annotated[str | None, typer.Option(help="What was held, if it is known.")] = None,
    library: LibraryOption = None,
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """Take LabVIEW logs into the data folder, as recordings like any other.

    Example: graspwatch import liver4Hz1.lvm.gz --tissue liver
    """
    settings = load_settings(config)
    profiles, rig_tool = load_library(library or settings.library), load_tool(tool)
    folder = prepare_data_folder(data, settings) / "recordings"

    # A slow import, made after the options are checked.
    from app.recordings.exchange.labview_import import import_labview
    from app.recordings.mcap_writer import RecordingContext

    for path in files:
        noted = journal_local_command(folder.parent, "import", f"Import {path.name}")
        with noted, ProgressBar(path.name, 1.0) as progress:
            written = import_labview(path, folder, RecordingContext(rig_tool, profiles, settings), tissue, progress)
        print(written)
