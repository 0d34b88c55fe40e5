"""`graspwatch check`: checks of a tool, from its driver to its jaws."""

import json
from dataclasses import asdict
from typing import Annotated

import typer
from rich.text import Text

from app.cli.console import create_console, error_console
from app.cli.options import ConfigOption, DataOption, JsonOption, ToolOption, locate_data_folder
from app.service.library_approvals import LibraryApprovals
from config.errors import ConfigurationError, ToolError
from config.load import FileKind, find_file, load_library, load_settings, load_tool

OUTCOME_STYLES = {"pass": "green", "fail": "bold red", "not done": "yellow"}
EMPTY_JAWS_QUESTION = "The jaws will close with half a volt. Are they empty, is nobody near them, and may they move?"


def check(
    tool: ToolOption = None,
    move: Annotated[
        bool | None, typer.Option("--move/--no-move", help="Close the empty jaws gently; else you are asked.")
    ] = None,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find out whether a tool is wired as its file says: pass or fail, and what to do. The motor is at zero afterwards.

    Example: graspwatch check --tool nidaq --move
    """
    settings = load_settings(config)
    own = locate_data_folder(data, settings)
    chosen = load_tool(tool or settings.tool, own)
    if not chosen.has_board:
        raise ConfigurationError(f"The tool {chosen.name!r} {chosen.why_no_motor}: there is nothing to check.")

    from acquisition.bench.checks import CheckOutcome  # a slow import, made after the options are checked
    from acquisition.tool_factory import open_hardware_check
    from acquisition.worker import REALTIME_PRIORITY
    from acquisition.worker_process import hold_realtime_priority

    def may_move() -> bool:
        is_asked = move is None and error_console.is_terminal and not as_json
        allowed = typer.confirm(EMPTY_JAWS_QUESTION, err=True) if is_asked else bool(move)
        if allowed and chosen.has_real_motor:
            LibraryApprovals(own).check(find_file(settings.library, FileKind.LIBRARY, own), settings.library)
        return allowed

    reading = hold_realtime_priority(REALTIME_PRIORITY)  # as in the worker
    console, findings = create_console(), []
    library = load_library(settings.library, own)
    for finding in open_hardware_check(chosen, library, reading).run_checks(may_move):
        findings.append(finding)
        if not as_json and finding.outcome is not CheckOutcome.NOT_DONE:
            console.print(_format_finding(finding.outcome, finding.check, finding.text), soft_wrap=True)
    not_done = [finding for finding in findings if finding.outcome is CheckOutcome.NOT_DONE]
    if as_json:
        print(json.dumps({"tool": chosen.name, "checks": [asdict(finding) for finding in findings]}, indent=2))
    else:
        for text in dict.fromkeys(finding.text for finding in not_done):
            names = ", ".join(finding.check for finding in not_done if finding.text == text)
            console.print(_format_finding(CheckOutcome.NOT_DONE, names, text), soft_wrap=True)
    failed = [finding.check for finding in findings if finding.outcome is CheckOutcome.FAIL]
    if failed:
        raise ToolError(f"{chosen.title} is not ready: {', '.join(failed)}. Do what stands beside, then check again.")
    if not as_json:
        console.print(f"{chosen.title}: all is well" + (f"; {len(not_done)} checks not done." if not_done else "."))


def _format_finding(outcome: str, check: str, text: str) -> Text:
    return Text.assemble((f"{outcome:<8}", OUTCOME_STYLES[outcome]), f" {check}: {text}")
