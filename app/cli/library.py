"""`graspwatch library`: own tissue libraries, their earlier texts, and which of them a real tool may use."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.cli.console import create_console, error_console, print_note
from app.cli.journaled import journal_local_command
from app.cli.options import ConfigOption, DataOption, JsonOption, find_data_folder, prepare_known_data_folder
from app.host.computer_user import computer_user_name
from app.service.library_approvals import (
    LibraryApprovals,
    compute_version,
    keep_version,
    list_versions,
    read_saved_time,
)
from config.atomic_write import write_atomically
from config.errors import ConfigurationError, build_write_error
from config.load import FileKind, list_files, load_file, load_own_file, load_settings, read_file_text
from config.schema import TissueLibrary

app = typer.Typer(
    help="Own tissue libraries: which of them a real tool may use, and their earlier texts. A simulated tool may use "
    "every library, and a shipped one needs no approval.",
    no_args_is_help=True,
)
NameArgument = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of an own library, or the path of a library file.")
]
MIN_REASON_LETTERS = 3
ReasonOption = Annotated[str, typer.Option(metavar="TEXT", help="Why; it is kept with the decision.")]


@app.command("list")
def list_(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="All texts of this library.")] = None,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """List own libraries, or the texts of one, each with the newest decision on it.

    Example: graspwatch library list
    """
    folder = find_data_folder(data, load_settings(config))
    libraries, approvals = folder / FileKind.LIBRARY.folder, LibraryApprovals(folder)
    paths = list_versions(libraries, name) if name else list_files(libraries)
    if name and not paths:
        raise ConfigurationError(f"There is no own library {name!r} in {libraries}.")
    rows = []
    for path in paths:
        try:
            text = read_file_text(path)
        except ConfigurationError as error:
            print_note(str(error))
            continue
        decision = approvals.find(text)
        rows.append(
            {
                "library": name or path.stem,
                "version": compute_version(text),
                "saved_at": read_saved_time(path),
                "current": path.parent == libraries,
                "approval": decision.model_dump(mode="json") if decision else None,
            }
        )
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    table = Table(title="Own tissue libraries")
    for heading in ("Library", "Version", "Saved", "On real tools"):
        table.add_column(heading)
    for row in rows:
        decision = row["approval"]
        state = "not approved" if decision is None else "approved" if decision["approved"] else "withdrawn"
        who = f" by {decision['by']}: {decision['reason']}" if decision else ""
        table.add_row(row["library"], row["version"], row["saved_at"], state + who)
    create_console().print(table)


@app.command()
def approve(name: NameArgument, reason: ReasonOption, config: ConfigOption = None, data: DataOption = None) -> None:
    """Approve the present text of a library for real tools.

    Example: graspwatch library approve ward_3 --reason "judged on 40 spots of 5 animals"
    """
    _decide(name, reason, config, data, approved=True)


@app.command()
def withdraw(name: NameArgument, reason: ReasonOption, config: ConfigOption = None, data: DataOption = None) -> None:
    """Withdraw the approval of the present text of a library. A running service goes on with it.

    Example: graspwatch library withdraw ward_3 --reason "a label was wrong"
    """
    _decide(name, reason, config, data, approved=False)


@app.command()
def restore(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of an own library.")],
    version: Annotated[str, typer.Argument(metavar="VERSION", help="As `graspwatch library list NAME` shows it.")],
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """Save an earlier text of a library again, with the decision that it has.

    Example: graspwatch library restore ward_3 5ff1a0c2e9d37b64
    """
    folder = prepare_known_data_folder(data, load_settings(config))
    libraries = folder / FileKind.LIBRARY.folder
    earlier = [path for path in list_versions(libraries, name) if path.parent != libraries]
    texts = {compute_version(read_file_text(path)): path for path in earlier}
    if version not in texts:
        raise ConfigurationError(
            f"There is no version {version!r} of {name!r}. See them with graspwatch library list {name}."
        )
    path, text = libraries / f"{name}.toml", read_file_text(texts[version])
    with journal_local_command(folder, "library restore", f"Restore library {name}, version {version}"):
        try:
            keep_version(path)
            write_atomically(path, text)
        except OSError as error:
            raise build_write_error(f"{path}: cannot be written ({error.strerror}).", error) from None
    error_console.print(f"{name} is version {version} again, for the next start of the service.", soft_wrap=True)


def _decide(name: str, reason: str, config: Path | None, data: Path | None, *, approved: bool) -> None:
    if len(reason.strip()) < MIN_REASON_LETTERS:
        raise ConfigurationError("--reason: say why, in a few words.")
    folder = prepare_known_data_folder(data, load_settings(config))
    is_path = name.endswith(".toml") or "/" in name
    path = Path(name) if is_path else folder / FileKind.LIBRARY.folder / f"{name}.toml"
    library = (load_file(path, TissueLibrary) if is_path else load_own_file(path, FileKind.LIBRARY)).name
    text = read_file_text(path)
    what = "Approve" if approved else "Withdraw the approval of"
    description = f"{what} library {library}, version {compute_version(text)}: {reason}"
    with journal_local_command(folder, "library approve" if approved else "library withdraw", description):
        LibraryApprovals(folder).add(library, text, approved=approved, reason=reason, by=computer_user_name())
    state = "approved" if approved else "no longer approved"
    error_console.print(f"{library}, version {compute_version(text)}: {state} for real tools.", soft_wrap=True)
