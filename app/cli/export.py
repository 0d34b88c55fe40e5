"""`graspwatch export`: a recorded run for other programs."""

from pathlib import Path
from typing import Annotated

import typer

from app.cli.options import ConfigOption, DataOption, find_recording_file
from app.recordings.exchange.export_formats import ExportFormat


def export(
    run: Annotated[str, typer.Argument(metavar="RUN|FILE", help="Id of a run of the data folder, or an .mcap file.")],
    export_format: Annotated[ExportFormat, typer.Option("--format", help="What to write.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Where to; default: the run's name in this folder.")
    ] = None,
    config: ConfigOption = None,
    data: DataOption = None,
) -> None:
    """Write a recorded run for other programs: every sample with its estimates, and every grasp.

    Example: graspwatch export 20261127-101500-001 --format parquet
    """
    source = find_recording_file(run, config, data)
    from app.recordings.exchange.export import export_run as write

    for path in write(source, out or Path(f"{source.stem}.{export_format.value}"), export_format):
        print(path)
