"""`graspwatch index`: what the index holds, and building it anew."""

import contextlib
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table
from sqlalchemy import URL
from sqlalchemy.exc import DBAPIError

from app.audit.local import local_deed
from app.store.faults import REBUILD
from app.store.rebuild import READERS, rebuild
from app.store.status import Status, status
from app.store.store import Store
from app.wire import JournalEntry
from config.errors import GraspwatchError


def show(url: URL, data: Path, as_json: bool) -> None:
    """Print where it is, how much is in it, and what it lacks."""
    found = status(url, data, READERS)
    if as_json:
        print(json.dumps(asdict(found), indent=2))
        return
    table = Table(title="Index", show_header=False)
    table.add_row("where", found.where)
    for name, count in found.counts.items():
        table.add_row(name, str(count))
    table.add_row("revision", _revision(found))
    table.add_row("lacks", "\n".join([*found.behind, f"Run `{REBUILD}`."]) if found.behind else "nothing")
    Console().print(table)


def _revision(found: Status) -> str:
    if found.revision is None:
        return "none"
    current = found.revision == found.newest_revision
    return (
        found.revision
        if current
        else f"{found.revision}; the next start of the service makes it {found.newest_revision}"
    )


def build_anew(url: URL, data: Path, errors: Console, progress: Callable[[float], None]) -> None:
    """Rebuild, and print what was found.

    Raises:
        ServiceError: see `rebuild`.
    """
    lines: list[JournalEntry] = []
    try:
        with local_deed(data, "index", "Rebuild the index", lines.append):
            rebuilt = rebuild(url, data, READERS, progress)
    finally:
        with contextlib.suppress(GraspwatchError, DBAPIError), contextlib.closing(Store(url)) as store:
            store.take_all((line, None) for line in lines)  # else the next service takes them
    for problem in rebuilt.problems:
        errors.print(f"Left out in part: {problem}", markup=False, soft_wrap=True)
    if rebuilt.broken_lines:
        errors.print(f"The journal has {rebuilt.broken_lines} broken lines; they were left out.", soft_wrap=True)
    if rebuilt.set_aside:
        errors.print(f"The old index is set aside: {rebuilt.set_aside}", markup=False, soft_wrap=True)
    print(f"Index rebuilt from {rebuilt.recordings} recordings and {rebuilt.lines} lines of the journal.")
