"""`graspwatch import`: recordings of other programs into the data folder."""

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquisition.recordings.file_names import to_printable
from app.cli.console import print_error, print_note
from app.cli.journaled import journal_local_command
from app.cli.options import (
    DEFAULT_RECORDING_TOOL,
    ConfigOption,
    DataOption,
    LibraryOption,
    ProgressBar,
    prepare_data_folder,
)
from config.errors import ConfigurationError, GraspwatchError
from config.load import load_library, load_settings, load_tool
from config.tissue_names import normalize_tissue_name

if TYPE_CHECKING:
    from sqlalchemy import URL

    from app.messages.lab_sessions import LabSession


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE", help="LabVIEW logs (.lvm, .lvm.gz), or tables as the tool file describes."),
    ],
    tool: Annotated[
        str,
        typer.Option(metavar="NAME|FILE", help="Tool file that names the channels or columns and their calibration."),
    ] = DEFAULT_RECORDING_TOOL,
    tissue: Annotated[str | None, typer.Option(help="What was held, if it is known.")] = None,
    name: Annotated[
        str | None, typer.Option(help="Name of the recording, with one FILE; default: the file's, without its ending.")
    ] = None,
    session: Annotated[
        str | None,
        typer.Option(metavar="ID", help="Laboratory session of these recordings; `now` for the one under way."),
    ] = None,
    library: LibraryOption = None,
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """Take logs of other programs into the data folder, as recordings like any other.

    With a [table] in the tool file these may be text (CSV, TSV, blanks), TDMS, MAT or Parquet files.

    A file that cannot be imported leaves nothing behind, and the others are imported.

    Example: graspwatch import liver4Hz1.lvm.gz --tissue liver
    """
    if name and len(files) > 1:
        raise ConfigurationError("--name is for one file. Import each file by itself, or leave --name out.")
    settings = load_settings(config)
    own = data or settings.data_folder
    profiles, rig_tool = load_library(library or settings.library, own), load_tool(tool, own)
    held = normalize_tissue_name(tissue, "--tissue") if tissue else None
    folder = prepare_data_folder(data, settings) / "recordings"

    # A slow import, made after the options are checked.
    from app.index.database import index_url_from_settings
    from app.recordings.exchange.log_import import import_log
    from app.recordings.mcap_writer import RecordingContext

    url = index_url_from_settings(settings, folder.parent)
    lab_session = _find_session(session, folder.parent, url) if session else None
    context, failed, imported_files = RecordingContext(rig_tool, profiles, settings), {}, []
    for path in files:
        noted = journal_local_command(folder.parent, "import", f"Import {path.name}")
        try:
            with noted, ProgressBar(to_printable(path.name), 1.0) as progress:
                imported = import_log(path, folder, context, held, progress, name, lab_session)
        except GraspwatchError as error:
            if len(files) == 1:
                raise
            failed[path] = error
            print_error(str(error))
            continue
        for remark in imported.remarks:
            print_note(f"{path}: {remark}.")
        print(imported.path)
        imported_files.append(imported.path)
    _index(imported_files, url)
    if failed:
        names = ", ".join(map(str, failed))
        raise next(iter(failed.values())).__class__(
            f"{len(failed)} of {len(files)} files were not imported: {names}. The message of each says why."
        )


def _find_session(session: str, data: Path, url: "URL") -> "LabSession":
    """Return a laboratory session of the data folder.

    Raises:
        ConfigurationError: there is none of this id, or none under way.
        ServiceError: the index is at fault.
    """
    from app.index.database import explain_database_errors
    from app.index.opening import ingest_journal_tail
    from app.index.store import Store

    with contextlib.closing(Store(url)) as store, explain_database_errors(url):
        ingest_journal_tail(store, data / "journal.jsonl")
        found = store.find_lab_session_under_way() if session == "now" else store.get_lab_session(session)
    if found is None:
        which = "no laboratory session under way" if session == "now" else f"no laboratory session {session!r}"
        raise ConfigurationError(
            f"--session: there is {which} in {data}. Begin one on the live page, or leave --session out."
        )
    return found


def _index(paths: list[Path], url: "URL") -> None:
    """Put new recordings into the index, so that a running service finds their grasps, too."""
    from app.index.opening import ingest_if_missing
    from app.index.store import Store
    from app.recordings.index_reader import RECORDING_READERS

    try:
        with contextlib.closing(Store(url)) as store:
            for path in paths:
                ingest_if_missing(store, path, RECORDING_READERS)
    except GraspwatchError as error:
        print_note(f"The index does not have them yet: {error}")
