"""Checks once a second of what changes slowly: disk space, and the age of the tool's calibration."""

from datetime import date

from app.host.disk import free_bytes
from app.stream.alarms import AlarmManager
from config.service_plan import ServicePlan
from estimator.force_alarms import Priority

LOW_DISK_BYTES = 200e6  # a few minutes of a recording


class ConditionChecks:
    """Checks with an alarm each."""

    def __init__(self, plan: ServicePlan, alarms: AlarmManager) -> None:
        self._plan, self._alarms = plan, alarms
        self.free_disk_bytes = free_bytes(plan.data_folder)

    def check_disk(self) -> None:
        """Update the alarm about disk space."""
        folder = self._plan.data_folder
        self.free_disk_bytes = free_bytes(folder)
        text = None
        if self.free_disk_bytes is None:
            text = f"The data folder {folder} is gone: mend it"
        elif self.free_disk_bytes < LOW_DISK_BYTES:
            text = f"The disk of {folder} is full: make room, or empty the bin of the recordings"
        self._alarms.update_technical("disk", Priority.MEDIUM, text)

    def check_calibration(self) -> None:
        """Raise alarms about constants that are expired and about a force scale that is not measured."""
        tool = self._plan.tool
        if expired := tool.find_expired_constants(date.today()):
            names = ", ".join(f"{each.constant} ({each.expires})" for each in expired)
            text = f"The tool's calibration is expired: {names}. Measure anew before you trust forces"
            self._alarms.raise_technical("calibration", Priority.LOW, text)
        if not tool.has_known_scale:
            text = f"The tool's force scale is not measured ({tool.scale_text}): newtons may be wrong by that much"
            self._alarms.raise_technical("scale", Priority.LOW, text)
