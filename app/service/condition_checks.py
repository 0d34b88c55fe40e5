"""The class ConditionChecks: alarms about what changes slowly: disk space, and the tool's calibration."""

import asyncio
import re
from datetime import date
from pathlib import Path

from app.host.disk import free_bytes
from app.stream.alarms import AlarmManager
from config.errors import ConfigurationError
from config.load import FileKind, list_files, load_own_file
from config.schema import Tool
from config.service_plan import ServicePlan
from estimator.force_alarms import Priority

ISO_DAY = re.compile(r"\d{4}-\d{2}-\d{2}")
LOW_DISK_BYTES = 200e6  # a few minutes of a recording


class ConditionChecks:
    """Checks of disk space and calibration, each of which raises its alarm or ends it."""

    def __init__(self, plan: ServicePlan, alarms: AlarmManager) -> None:
        self._plan, self._alarms = plan, alarms
        self.free_disk_bytes = free_bytes(plan.data_folder)

    def check_disk(self) -> None:
        """Raise the alarm about disk space, or end it."""
        folder = self._plan.data_folder
        self.free_disk_bytes = free_bytes(folder)
        text = None
        if self.free_disk_bytes is None:
            text = f"The data folder {folder} is gone: mend it"
        elif self.free_disk_bytes < LOW_DISK_BYTES:
            text = f"The disk of {folder} is full: make room, or empty the bin of the recordings"
        self._alarms.update_technical("disk", Priority.MEDIUM, text)

    def check_calibration(self) -> None:
        """Raise or end the alarms about expired constants and about a force scale that is not measured."""
        tool = self._plan.tool
        text = None
        if expired := tool.find_expired_constants(date.today()):
            names = ", ".join(f"{each.constant} ({each.expires})" for each in expired)
            text = f"The tool's calibration is expired: {names}. Measure anew before you trust forces"
        self._alarms.update_technical("calibration", Priority.LOW, text)
        text = None
        if not tool.has_known_scale:
            text = f"The tool's force scale is not measured ({tool.scale_text}): newtons may be wrong by that much"
        self._alarms.update_technical("scale", Priority.LOW, text)

    async def check_newer_calibration(self) -> None:
        """Update the alarm about a tool file of the data folder with newer constants than those in use."""
        tool, source = self._plan.tool, Path(self._plan.tool_source)
        newer = await asyncio.to_thread(_find_newer_calibration, tool, source, self._plan.data_folder)
        text = None
        if newer:
            text = (
                f"The tool is used as {source.stem} says, though there is a newer calibration of it, {newer.stem}. Use "
                "that file (System, Protocols, libraries, tools), and name it in the settings for the next start"
            )
        self._alarms.update_technical("newer-calibration", Priority.MEDIUM, text)


def _find_newer_calibration(tool: Tool, source: Path, data_folder: Path) -> Path | None:
    """Return the own file with the newest constants of the same tool, unless they are those in use.

    A calibration states the day only. Of files of one day, the one that was written last is the newest.
    """
    newest, found = _find_age(tool, source), None
    for path in list_files(data_folder / FileKind.TOOL.folder):
        try:
            other = load_own_file(path, FileKind.TOOL)
            assert isinstance(other, Tool)
            is_same = not tool.find_differences_beside_constants(other)
            if is_same and other != tool and (age := _find_age(other, path)) > newest:
                newest, found = age, path
        except ConfigurationError:
            continue  # the list of files shows its faults
    return found


def _find_age(tool: Tool, path: Path) -> tuple[str, int]:
    """Return the day of the newest constant, and the time at which the file was written, ns; 0 if it is gone."""
    days = [each.date for each in tool.constant_origins if ISO_DAY.fullmatch(each.date)]  # a person writes some of them
    return max(days, default=""), path.stat().st_mtime_ns if path.exists() else 0
