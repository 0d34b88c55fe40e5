"""Journal entries for changes that a command makes in a data folder."""

import contextlib
import getpass
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from acquisition.recordings.file_names import to_printable
from app.audit.journal import Journal
from app.cli.console import error_console
from app.messages.journal import JournalEntry, Result
from config.errors import GraspwatchError


@contextlib.contextmanager
def journal_local_command(
    data: Path, action: str, description: str, on_entry: Callable[[JournalEntry], object] = lambda _: None
) -> Iterator[None]:
    """Write a journal entry for the block inside, done or failed with `GraspwatchError`."""
    journal, description = Journal(data, _print_warning, on_entry), to_printable(description)
    client = f"this machine: graspwatch {action}"
    try:
        yield
    except GraspwatchError as error:
        journal.write_request(
            action, description, client=client, result=Result.FAILED, by=_user_name(), reason=to_printable(str(error))
        )
        raise
    journal.write_request(action, description, client=client, result=Result.DONE, by=_user_name())


def _user_name() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container may have no user names
        return f"user {os.getuid()}"


def _print_warning(fault: str | None) -> None:
    if fault:
        error_console.print(f"Not noted: {fault}.", soft_wrap=True)
