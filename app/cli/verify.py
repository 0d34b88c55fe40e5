"""`graspwatch verify`: whether a recording is as it was made."""

import json
from dataclasses import asdict
from typing import Annotated

import typer

from app.cli.options import ConfigOption, DataOption, JsonOption, find_recording_file, locate_data_folder
from config.errors import RecordingError
from config.load import load_settings


def verify(
    run: Annotated[str, typer.Argument(metavar="RUN|FILE", help="Id of a run of the data folder, or an .mcap file.")],
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check a recording: its file, samples and manifest, and that the journal knows it.

    The journal holds the SHA-256 of each file that a service completed. Exit code 3: a check failed.

    Example: graspwatch verify 20261127-101500-001
    """
    path = find_recording_file(run, config, data)
    from rich.table import Table

    from app.audit.journal_file import find_journals
    from app.cli.console import create_console
    from app.recordings.verification import Outcome, verify_recording  # a slow import

    around = path.resolve().parent.parent  # the data folder, if the recording lies where it was made
    folder = around if data is None and find_journals(around) else locate_data_folder(data, load_settings(config))
    findings = verify_recording(path, folder if folder.is_dir() else None)
    failed = [each for each in findings if each.outcome is Outcome.FAILED]
    if as_json:
        document = {"recording": str(path), "passed": not failed, "findings": [asdict(each) for each in findings]}
        print(json.dumps(document, indent=2))
    else:
        table = Table("", "Outcome", "What was found", title=path.name)
        for each in findings:
            table.add_row(each.subject, each.outcome.value, each.text)
        create_console().print(table)
    if failed:
        what = "; ".join(f"{each.subject}: {each.text}" for each in failed)
        raise RecordingError(
            f"{path} does not match its records: {what}. Restore the recording from a backup, and keep this file "
            "unchanged for an investigation."
        )
