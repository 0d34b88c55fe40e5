"""`graspwatch audit`: verification and export of the journal."""

import sys
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from app.audit.chain_check import ChainCheckpoint, check_journal
from app.audit.journal_export import JournalFilter, JournalFormat
from app.audit.journal_export import export_lines as lines
from app.cli.console import create_console
from app.cli.options import ConfigOption, DataOption, JsonOption, ProgressBar, explain_write_errors, find_data_folder
from app.messages.journal import JournalCheck, JournalEntry
from config.atomic_write import open_atomically
from config.errors import ConfigurationError, GraspwatchError, JournalError
from config.load import load_settings
from config.schema import Settings

app = typer.Typer(help="Check the journal, which keeps who did what from where, or write it out.", no_args_is_help=True)
TimeOption = Annotated[str | None, typer.Option(metavar="TIME", help="ISO 8601; without a zone UTC.")]


@app.command()
def verify(config: ConfigOption = None, data: DataOption = None, as_json: JsonOption = False) -> None:
    """Tell whether any line of the journal was changed, removed, put in or moved, and the first such place.

    Its own chain is followed, and compared with what the index and the recordings know of it. Exit code 7: it is not
    as it was written.

    Example: graspwatch audit verify --data graspwatch-data
    """
    settings = load_settings(config)
    folder = find_data_folder(data, settings)
    notes: list[str] = []
    index = _read_index_checkpoints(settings, folder, notes)
    found = check_journal(folder, index, _read_recording_checkpoints(folder, notes))
    found = found.model_copy(update={"notes": [*found.notes, *notes]})
    if as_json:
        print(found.model_dump_json(indent=2))
    else:
        _print_result(found)
    if found.problem:
        raise JournalError(
            f"The journal in {folder} is not as it was written: {found.problem}. Keep a copy of the folder as it is, "
            "and compare it with a backup."
        )


def _print_result(found: JournalCheck) -> None:
    console = create_console()
    for note in found.notes:
        console.print(f"Note: {note}.", soft_wrap=True)
    if found.whole and found.newest:
        console.print(f"The journal is whole: {found.lines} lines. The newest, {found.newest}, has the hash", end=" ")
        console.print(found.newest_hash, soft_wrap=True)


def _read_index_checkpoints(settings: Settings, folder: Path, notes: list[str]) -> list[ChainCheckpoint]:
    """Read the index's checkpoints; if that fails, add a note, as the chain itself can still be checked."""
    from app.index.database import index_url_from_settings
    from app.index.status import read_chain_positions

    try:
        return [
            ChainCheckpoint("the index", *each)
            for each in read_chain_positions(index_url_from_settings(settings, folder))
        ]
    except GraspwatchError as error:
        notes.append(f"the index was not asked: {str(error).rstrip('.')}")
        return []


def _read_recording_checkpoints(folder: Path, notes: list[str]) -> list[ChainCheckpoint]:
    from app.index.rebuild import find_recordings
    from app.recordings.index_reader import RECORDING_READERS

    known: list[ChainCheckpoint | None] = []
    recordings = find_recordings(folder, RECORDING_READERS)
    with ProgressBar("Asking the recordings", max(len(recordings), 1)) as progress:
        for done, (path, reader) in enumerate(recordings.items()):
            progress(done)
            try:
                for _, message in reader.read_messages(path):
                    if isinstance(message, JournalEntry):
                        known.append(ChainCheckpoint.from_entry(f"the recording {path.name}", message))
            except GraspwatchError as error:
                notes.append(f"a recording was not asked to its end: {str(error).rstrip('.')}")
    return [each for each in known if each]


@app.command()
def export(
    journal_format: Annotated[
        JournalFormat, typer.Option("--format", help="A table, or the lines as they stand.")
    ] = JournalFormat.CSV,
    since: TimeOption = None,
    until: TimeOption = None,
    by: Annotated[str | None, typer.Option(help="Only what this person did or wanted.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Where to; default: standard output.")] = None,
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """Write out the journal, oldest line first.

    Example: graspwatch audit export --format csv --since 2026-11-01 --by Ada --out november.csv
    """
    folder = find_data_folder(data, load_settings(config))
    chosen = JournalFilter(_parse_time("--since", since), _parse_time("--until", until), by)
    if out is None:
        for line in lines(folder, chosen, journal_format):
            sys.stdout.buffer.write(line)
        sys.stdout.flush()
        return
    with explain_write_errors(out), open_atomically(out, overwrite=False) as file:
        file.writelines(lines(folder, chosen, journal_format))
    print(out)


def _parse_time(option: str, text: str | None) -> datetime | None:
    try:
        return datetime.fromisoformat(text) if text else None
    except ValueError:
        raise ConfigurationError(f"{option}: {text!r} is no moment. Write 2026-11-01 or 2026-11-01T08:00Z.") from None
