"""`graspwatch bench`: how late this machine reads samples, with and without real-time settings, idle and busy."""

import json
import os
import platform
from dataclasses import asdict
from typing import Annotated

import typer
from rich.table import Table

from app.cli.console import create_console, error_console
from app.cli.options import ConfigOption, DataOption, JsonOption, ToolOption, locate_data_folder
from config.errors import ConfigurationError
from config.load import load_library, load_settings, load_tool
from config.schema import RealtimeSettings


def bench(
    jitter: Annotated[bool, typer.Option("--jitter", help="Lateness of blocks, the only measurement so far.")] = False,
    seconds: Annotated[float, typer.Option(min=1, max=3600, help="Of each of the six measurements.")] = 30.0,
    tool: ToolOption = None,
    config: ConfigOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure how late blocks of samples are: without any of `[realtime]`, as configured, and with all of it.

    Each on an idle machine, and beside one busy program a core. The motor stays at zero.

    Example: graspwatch bench --jitter --seconds 60
    """
    if not jitter:
        raise ConfigurationError("Say what to measure: --jitter.")
    settings = load_settings(config)
    own = locate_data_folder(data, settings)
    chosen, library = (load_tool(tool or settings.tool, own), load_library(settings.library, own))
    if not chosen.has_motor:
        raise ConfigurationError(f"The tool {chosen.name!r} {chosen.why_no_motor}: there is nothing to measure.")

    from acquisition.bench.jitter import keep_cores_busy, measure_jitter  # a slow import
    from acquisition.tool_factory import open_tool
    from acquisition.worker import REALTIME_PRIORITY

    last_core = max(os.sched_getaffinity(0))
    ways = {
        "nothing": RealtimeSettings(priority=False, freeze_garbage=False),
        "as configured": settings.realtime,
        "everything": RealtimeSettings(lock_memory=True, cores=(last_core,)),
    }
    found = []
    for busy in (False, True):
        for name, wanted in ways.items():
            with error_console.status(f"Measuring: {name}, {'busy' if busy else 'idle'}"), keep_cores_busy(busy):
                result = measure_jitter(open_tool, chosen, library, settings, wanted, REALTIME_PRIORITY, seconds)
            found.append({"asked for": name, "machine": "busy" if busy else "idle", **asdict(result)})
    if as_json:
        about = {"machine": f"{platform.system()} {platform.release()}", "cores": os.cpu_count(), "tool": chosen.name}
        print(json.dumps(about | {"measured": found}, indent=2))
        return
    table = Table("machine", "asked for", "median", "99 %", "99.9 %", "longest", title="Lateness of a block, ms")
    for each in found:
        table.add_row(each["machine"], each["asked for"], *(f"{value:.2f}" for value in each["late_ms"].values()))
    console = create_console()
    console.print(table)
    for each in found:
        if each["ended"]:
            console.print(f"{each['machine']}, {each['asked for']}: after {each['blocks']} blocks: {each['ended']}")
    for each in found[: len(ways)]:
        console.print(f"{each['asked for']}: {each['granted']}", soft_wrap=True)
