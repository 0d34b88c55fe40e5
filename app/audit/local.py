"""What a program on this machine changes in a data folder stands in its journal too."""

import contextlib
import getpass
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from app.journal import Journal
from app.options import errors
from app.wire import JournalEntry, Result
from config.errors import GraspwatchError


@contextlib.contextmanager
def local_deed(
    data: Path, action: str, what: str, on_entry: Callable[[JournalEntry], object] = lambda _: None
) -> Iterator[None]:
    """Note what is done inside, whether it succeeds or fails."""
    journal = Journal(data, _warn, on_entry)
    client = f"this machine: graspwatch {action}"
    try:
        yield
    except GraspwatchError as error:
        journal.deed(action, what, client=client, result=Result.FAILED, by=_user(), reason=str(error))
        raise
    journal.deed(action, what, client=client, result=Result.DONE, by=_user())


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container may have no names
        return f"user {os.getuid()}"


def _warn(fault: str | None) -> None:
    if fault:
        errors.print(f"Not noted: {fault}.", markup=False, soft_wrap=True)
