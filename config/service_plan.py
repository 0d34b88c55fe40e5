"""The class ServicePlan: decided from command line and configuration, then passed to every part of a service."""

from dataclasses import dataclass
from pathlib import Path

from config.schema import Settings, TissueLibrary, Tool


@dataclass(slots=True)
class ServicePlan:
    """The parameters of one service. None changes but `tool` and `tool_source`, when a new calibration is used.

    `recording_tool` is the tool for recordings that contain none. `tool_source` is the tool's file.
    With `opened_recordings` there is no tool, and the service only shows these recordings. `demo_enabled` repeats a
    protocol on each tissue in turn.
    """

    tool: Tool
    library: TissueLibrary
    settings: Settings
    simulated_tissue: str
    seed: int
    data_folder: Path
    recording_tool: Tool
    opened_recordings: tuple[Path, ...] = ()
    demo_enabled: bool = False
    tool_source: str = ""

    @property
    def recordings_folder(self) -> Path:
        return self.data_folder / "recordings"

    @property
    def references_folder(self) -> Path:
        return self.data_folder / "references"

    @property
    def studies_folder(self) -> Path:
        return self.data_folder / "studies"

    @property
    def reports_folder(self) -> Path:
        return self.data_folder / "reports"
