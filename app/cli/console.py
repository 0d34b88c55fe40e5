"""Consoles of the commands. Text is printed as it is: brackets and colons in names are no markup."""

import io
import sys

from rich.console import Console
from rich.text import Text


def create_console(*, stderr: bool = False) -> Console:
    """Return a console that takes no text for markup or emoji; styled text is a `Text`."""
    return Console(stderr=stderr, highlight=False, markup=False, emoji=False)


error_console = create_console(stderr=True)


def print_error(text: str) -> None:
    """Print the message of an error."""
    error_console.print(Text.assemble(("Error:", "bold red"), " ", text), soft_wrap=True)


def print_note(text: str) -> None:
    """Print a remark that is no error."""
    error_console.print(Text.assemble(("Note:", "yellow"), " ", text), soft_wrap=True)


def escape_unencodable_output() -> None:
    """Let the output print an escape for each character that it cannot encode, as the error output does."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
