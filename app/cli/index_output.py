"""What `graspwatch index` does and prints; apart, because the index's libraries are slow to import."""

import contextlib
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table
from sqlalchemy import URL
from sqlalchemy.exc import DBAPIError

from app.cli.console import create_console
from app.cli.journaled import journal_local_command
from app.index.database_errors import REBUILD_COMMAND
from app.index.rebuild import rebuild
from app.index.status import IndexStatus, read_status
from app.index.store import Store
from app.messages.journal import JournalEntry
from app.recordings.index_reader import RECORDING_READERS
from config.errors import GraspwatchError


def print_status(url: URL, data: Path, as_json: bool) -> None:
    """Print where the index is, how much it holds, and what it lacks."""
    found = read_status(url, data, RECORDING_READERS)
    if as_json:
        print(json.dumps(asdict(found), indent=2))
        return
    table = Table(title="Index", show_header=False)
    table.add_row("where", found.where)
    for name, count in found.counts.items():
        table.add_row(name, str(count))
    table.add_row("revision", _format_revision(found))
    table.add_row("lacks", "\n".join([*found.behind, f"Run `{REBUILD_COMMAND}`."]) if found.behind else "nothing")
    create_console().print(table)


def _format_revision(found: IndexStatus) -> str:
    if found.revision is None:
        return "none"
    current = found.revision == found.newest_revision
    return (
        found.revision
        if current
        else f"{found.revision}; the next start of the service makes it {found.newest_revision}"
    )


def rebuild_and_report(url: URL, data: Path, error_console: Console, progress: Callable[[float], None]) -> None:
    """Rebuild the index, and print what was found.

    Raises:
        ServiceError: see `rebuild`.
    """
    lines: list[JournalEntry] = []
    try:
        with journal_local_command(data, "index", "Rebuild the index", lines.append):
            rebuilt = rebuild(url, data, RECORDING_READERS, progress)
    finally:
        with contextlib.suppress(GraspwatchError, DBAPIError), contextlib.closing(Store(url)) as store:
            store.ingest_all((line, None) for line in lines)  # if this fails, the next service adds them
    for problem in rebuilt.problems:
        error_console.print(f"Left out in part: {problem}", soft_wrap=True)
    if rebuilt.broken_lines:
        error_console.print(f"The journal has {rebuilt.broken_lines} broken lines; they were left out.", soft_wrap=True)
    if rebuilt.backup_path:
        error_console.print(f"The old index is set aside: {rebuilt.backup_path}", soft_wrap=True)
    print(f"Index rebuilt from {rebuilt.recordings} recordings and {rebuilt.lines} lines of the journal.")
