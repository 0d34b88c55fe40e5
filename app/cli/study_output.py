"""The result of a study or an evaluation: its files, and what is printed of it."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from app.cli.console import create_console
from app.cli.options import explain_write_errors

if TYPE_CHECKING:
    from estimator.studies.study_report import StudyResult


def print_study(study: "StudyResult", out: Path, as_json: bool) -> None:
    """Write the page and the figures into the folder `out`, and print the figures or, with `as_json`, the document.

    Raises:
        ConfigurationError: a file cannot be written.
        ServiceError: the disk is full.
    """
    with explain_write_errors(out):
        page, data = study.write(out)
    if as_json:
        print(json.dumps(study.to_document(), indent=2, allow_nan=False))
        return
    table = Table("Figure", "Measured", "To reach", "", title=study.title)
    words = {True: "reached", False: Text("not reached", "bold red"), None: ""}
    for figure in study.figures:
        value = "–" if figure.value is None else f"{figure.value:.3g} {figure.unit}".rstrip()
        table.add_row(figure.name, value, figure.floor, words[figure.reached])
    console = create_console()
    console.print(table)
    console.print(f"Report: {page}\nFigures: {data}", soft_wrap=True)
