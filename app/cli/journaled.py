"""Journal entries for changes that a command makes in a data folder."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

from acquisition.recordings.file_names import to_printable
from app.audit.journal import Journal
from app.cli.console import error_console
from app.host.computer_user import computer_user_name
from app.messages.journal import JournalEntry, Result
from config.errors import GraspwatchError


@contextlib.contextmanager
def journal_local_command(
    data: Path, action: str, description: str, on_entry: Callable[[JournalEntry], object] = lambda _: None
) -> Iterator[None]:
    """Run the `with` block, then write a journal entry: done, or failed if it raised `GraspwatchError`."""
    journal, description = Journal(data, _print_warning, on_entry), to_printable(description)
    client = f"this machine: graspwatch {action}"
    try:
        yield
    except GraspwatchError as error:
        journal.write_request(
            action,
            description,
            client=client,
            result=Result.FAILED,
            by=computer_user_name(),
            reason=to_printable(str(error)),
        )
        raise
    journal.write_request(action, description, client=client, result=Result.DONE, by=computer_user_name())


def _print_warning(fault: str | None) -> None:
    if fault:
        error_console.print(f"Not noted: {fault}.", soft_wrap=True)
