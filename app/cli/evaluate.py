"""`graspwatch evaluate`: how right and how honest the answers are, by what was held."""

from pathlib import Path
from typing import Annotated

import typer

from app.cli.grasp_collection import collect, find_files, read_corrections
from app.cli.label_option import LABEL_HELP, LABEL_METAVAR
from app.cli.options import (
    DEFAULT_RECORDING_TOOL,
    ConfigOption,
    DataOption,
    JsonOption,
    ToolOption,
    explain_write_errors,
    locate_data_folder,
)
from app.cli.study_output import print_study
from config.atomic_write import check_writable
from config.errors import ConfigurationError
from config.load import load_library, load_settings, load_tool

AS_RECORDED = "as recorded, logs with {}"


def evaluate(
    recordings: Annotated[
        list[Path] | None, typer.Argument(metavar="FILE...", help="Recordings: .mcap, LabVIEW's .lvm, or tables.")
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="All recordings of the data folder that can be read.")
    ] = False,
    label: Annotated[
        list[str] | None, typer.Option(metavar=LABEL_METAVAR, help=f"{LABEL_HELP} It counts as the grasps' truth.")
    ] = None,
    library: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME|FILE", help="Estimate anew with this library; repeat it to compare several."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the page and the figures.")] = Path(),
    tool: ToolOption = None,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Judge answers by what was held: share right and wrong, calibration, log loss, time to decision, confusion.

    Without --library the answers are those that .mcap recordings were recorded with. A list of the grasps that deserve
    a second look is on the page.

    Example: graspwatch evaluate --all --library porcine --library learned.toml
    """
    settings = load_settings(config)
    own = locate_data_folder(data, settings)
    files, labels = find_files(recordings, label, everything=everything, data=data, settings=settings)
    with explain_write_errors(out):
        check_writable(out)
    log_tool, default = load_tool(tool or DEFAULT_RECORDING_TOOL, own), load_library(settings.library, own)
    libraries = {name: load_library(name, own) for name in library or []}
    if len({each.name for each in libraries.values()}) < len(libraries):
        raise ConfigurationError("Two of the libraries have the same name. Rename one in its file.")

    from app.analysis.evaluation import evaluate_answers
    from app.analysis.grasp_collection import EstimationContext  # slow imports, made after the options are checked

    corrections, required_files = read_corrections(files, own, settings), {*(recordings or []), *labels}
    groups = {
        each.name if each else AS_RECORDED.format(default.name): collect(
            files, EstimationContext(log_tool, settings, each, each or default), corrections, labels, required_files
        )
        for each in (libraries.values() if libraries else [None])
    }
    about = {"recordings": len(files), "tool": log_tool.name, "libraries": ", ".join(groups)}
    print_study(evaluate_answers(groups, about), out, as_json)
