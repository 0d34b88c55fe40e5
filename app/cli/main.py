"""The `graspwatch` command: registers the commands, one module each, and prints their errors."""

import sys
from typing import Annotated

import typer

from app import __version__
from app.cli import audit, calibrate, study
from app.cli import token as people
from app.cli.bench import bench
from app.cli.check import check
from app.cli.console import accept_any_name, print_error
from app.cli.export import export
from app.cli.import_ import import_
from app.cli.index import index
from app.cli.label_option import LabelCommand, LearnCommand
from app.cli.learn import learn
from app.cli.replay import replay
from app.cli.report import report
from app.cli.run import run
from app.cli.serve import serve
from app.cli.support import support
from config.errors import GraspwatchError

app = typer.Typer(
    name="graspwatch",
    help="Names the tissue in a laparoscopic grasper while it closes, and shows how near the force is to injuring it. "
    "Research instrument, not a medical device.",
    epilog="Exit codes: 0 done, 2 wrong use or configuration, 3 recording, 4 tool, 5 refused, 6 service, 7 journal, "
    "8 calibration.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(study.app, name="study")
app.add_typer(audit.app, name="audit")
app.add_typer(people.app, name="token")
app.add_typer(calibrate.app, name="calibrate")
app.command("import")(import_)
for command in (export, check, bench, support):
    app.command()(command)
app.command(cls=LabelCommand)(report)
app.command(cls=LearnCommand)(learn)
for command in (serve, run, replay, index):
    app.command()(command)


@app.callback(invoke_without_command=True)
def version(
    show_version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    if show_version:
        print(__version__)
        raise typer.Exit


def main() -> None:
    """Run the command line; print an expected error as one message, and exit with its code."""
    accept_any_name()
    try:
        app()
    except GraspwatchError as error:
        print_error(str(error))
        sys.exit(error.exit_code)
    except BrokenPipeError:
        sys.exit(0)


if __name__ == "__main__":
    main()
