"""The `graspwatch` command: registers the commands, one module each, and prints their errors."""

import sys
from typing import Annotated, Any

import typer

from app import __version__
from app.cli import audit, calibrate, library, study, tool
from app.cli import token as people
from app.cli.bench import bench
from app.cli.check import check
from app.cli.console import escape_unencodable_output, print_error
from app.cli.evaluate import evaluate
from app.cli.export import export
from app.cli.grasps import grasps
from app.cli.import_ import import_
from app.cli.index import index
from app.cli.label import label
from app.cli.label_option import LabelCommand, LearnCommand
from app.cli.learn import learn
from app.cli.replay import replay
from app.cli.report import report
from app.cli.run import run
from app.cli.serve import serve
from app.cli.support import support
from app.cli.verify import verify
from app.host.process_end import discard_output
from config.errors import GraspwatchError
from config.home_folder import expand_home_in_argument

PATH_METAVARS = ("FILE", "FOLDER")

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
app.add_typer(tool.app, name="tool")
app.add_typer(library.app, name="library")
app.command("import")(import_)
for command in (export, label, verify, check, bench, support):
    app.command()(command)
app.command(cls=LabelCommand)(report)
app.command(cls=LabelCommand)(grasps)
app.command(cls=LabelCommand)(evaluate)
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
    escape_unencodable_output()
    try:
        try:
            command = typer.main.get_command(app)
            command(expand_paths(sys.argv[1:], command))
        finally:
            if sys.stdout:  # closed by the caller otherwise
                sys.stdout.flush()
    except GraspwatchError as error:
        print_error(str(error))
        sys.exit(error.exit_code)
    except BrokenPipeError:
        discard_output()
        sys.exit(0)


def _list_text_options(command: Any) -> set[str]:
    """Return a command's options, and those of its subcommands, that do not take a path; their metavar tells."""
    below = getattr(command, "commands", {}).values()
    own = {
        name
        for option in command.params
        if option.param_type_name == "option" and not option.is_flag
        if not any(word in (option.metavar or "") for word in PATH_METAVARS)
        for name in option.opts
    }
    return own.union(*map(_list_text_options, below))


def expand_paths(arguments: list[str], command: Any) -> list[str]:
    """Expand `~` in arguments that may be paths: all but the values of options for other text."""
    text_options = _list_text_options(command)
    expanded, before = [], ""
    for argument in arguments:
        option = argument.partition("=")[0] if argument.startswith("-") else before
        expanded.append(argument if option in text_options else expand_home_in_argument(argument))
        before = argument
    return expanded
