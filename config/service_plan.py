"""The plan of a service: decided once from command line and configuration, then passed to every part."""

from dataclasses import dataclass
from pathlib import Path

from config.schema import Settings, TissueLibrary, Tool


@dataclass(frozen=True, slots=True)
class ServicePlan:
    """The parameters of one service.

    `recording_tool` is the tool for recordings that contain none. `tool_source` is the tool's name or file as given.
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
    def studies_folder(self) -> Path:
        return self.data_folder / "studies"

    @property
    def reports_folder(self) -> Path:
        return self.data_folder / "reports"
