"""`graspwatch index`: status of the index, and its rebuild."""

from typing import Annotated

import typer

from app.cli.console import error_console, print_note
from app.cli.options import ConfigOption, DataOption, JsonOption, ProgressBar, find_data_folder, locate_data_folder
from config.errors import ConfigurationError
from config.load import load_settings


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
    from app.cli.index_output import print_status, rebuild_and_report
    from app.index.database import index_url_from_settings

    settings = load_settings(config)
    folder = find_data_folder(data, settings) if rebuild else locate_data_folder(data, settings)
    url = index_url_from_settings(settings, folder)
    if not rebuild:
        if not folder.is_dir():
            print_note(f"{folder}: there is no such folder. If it should be there, correct --data.")
        print_status(url, folder, as_json)
        return
    if as_json:
        raise ConfigurationError("--json tells what the index holds; leave it out with --rebuild.")
    with ProgressBar("Rebuilding the index", 1.0) as progress:
        rebuild_and_report(url, folder, error_console, progress)
