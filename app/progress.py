"""The progress bar of commands that take a while."""

import time

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class ProgressBar:
    """A progress bar on the error output where that is a terminal; calls take what is done."""

    def __init__(self, title: str, total: float, errors: Console) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal)
        self._task = self._bar.add_task(title, total=total)
        self._due_s = 0.0

    def __enter__(self) -> "ProgressBar":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, done: float) -> None:
        if not self._bar.disable and time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + 0.1
            self._bar.update(self._task, completed=done)
