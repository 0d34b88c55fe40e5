"""`graspwatch audit`: whether the journal is as it was written, and its lines for others."""

import sys
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from app.audit.check import Witness, check
from app.audit.export import JournalFormat, Wanted
from app.audit.export import export as lines
from app.options import ConfigOption, DataOption, JsonOption, ProgressBar, data_folder
from app.wire import JournalCheck, JournalEntry
from config.errors import ConfigurationError, GraspwatchError, JournalError
from config.load import load_settings
from config.schema import Settings

app = typer.Typer(help="Check the journal, which keeps who did what from where, or write it out.", no_args_is_help=True)
MomentOption = Annotated[str | None, typer.Option(metavar="TIME", help="ISO 8601; without a zone UTC.")]


@app.command()
def verify(config: ConfigOption = None, data: DataOption = None, as_json: JsonOption = False) -> None:
    """Tell whether any line of the journal was changed, removed, put in or moved, and the first such place.

    Its own chain is followed, and compared with what the index and the recordings know of it. Exit code 7: it is not
    as it was written.

    Example: graspwatch audit verify --data graspwatch-data
    """
    settings = load_settings(config)
    folder = data_folder(data, settings)
    notes: list[str] = []
    index = _index_knows(settings, folder, notes)
    found = check(folder, index, _recordings_know(folder, notes))
    found = found.model_copy(update={"notes": [*found.notes, *notes]})
    if as_json:
        print(found.model_dump_json(indent=2))
    else:
        _show(found)
    if found.problem:
        raise JournalError(
            f"The journal in {folder} is not as it was written: {found.problem}. Keep a copy of the folder as it is, "
            "and compare it with a backup."
        )


def _show(found: JournalCheck) -> None:
    console = Console()
    for note in found.notes:
        console.print(f"Note: {note}.", markup=False, soft_wrap=True)
    if found.whole and found.newest:
        console.print(f"The journal is whole: {found.lines} lines. The newest, {found.newest}, has the hash", end=" ")
        console.print(found.newest_hash, soft_wrap=True)


def _index_knows(settings: Settings, folder: Path, notes: list[str]) -> list[Witness]:
    """An index that cannot be asked does not keep the chain itself from being checked."""
    from app.store.database import index_url_of
    from app.store.status import chained

    try:
        return [Witness("the index", *each) for each in chained(index_url_of(settings, folder))]
    except GraspwatchError as error:
        notes.append(f"the index was not asked: {str(error).rstrip('.')}")
        return []


def _recordings_know(folder: Path, notes: list[str]) -> list[Witness]:
    from app.store.rebuild import READERS, recordings_in

    known = []
    recordings = recordings_in(folder, READERS)
    with ProgressBar("Asking the recordings", max(len(recordings), 1)) as progress:
        for done, (path, reader) in enumerate(recordings.items()):
            progress(done)
            try:
                for _, message in reader.recorded_messages(path):
                    if isinstance(message, JournalEntry) and message.chain and message.number and message.hash:
                        place = message.chain, message.number, message.hash, message.text
                        known.append(Witness(f"the recording {path.name}", *place))
            except GraspwatchError as error:
                notes.append(f"a recording was not asked to its end: {str(error).rstrip('.')}")
    return known


@app.command()
def export(
    wanted: Annotated[
        JournalFormat, typer.Option("--format", help="A table, or the lines as they stand.")
    ] = JournalFormat.CSV,
    since: MomentOption = None,
    until: MomentOption = None,
    by: Annotated[str | None, typer.Option(help="Only what this person did or wanted.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Where to; default: standard output.")] = None,
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """Write out the journal, oldest line first.

    Example: graspwatch audit export --format csv --since 2026-11-01 --by Ada --out november.csv
    """
    folder = data_folder(data, load_settings(config))
    chosen = Wanted(_moment("--since", since), _moment("--until", until), by)
    if out is None:
        for line in lines(folder, chosen, wanted):
            sys.stdout.buffer.write(line)
        sys.stdout.flush()
        return
    try:
        with out.open("xb") as file:
            file.writelines(lines(folder, chosen, wanted))
    except OSError as error:
        raise ConfigurationError(f"{out}: cannot be written ({error.strerror}). Name another file.") from None
    print(out)


def _moment(option: str, text: str | None) -> datetime | None:
    try:
        return datetime.fromisoformat(text) if text else None
    except ValueError:
        raise ConfigurationError(f"{option}: {text!r} is no moment. Write 2026-11-01 or 2026-11-01T08:00Z.") from None
