"""What a service is to be: decided once from the command line and the configuration, then handed to every part."""

from dataclasses import dataclass
from pathlib import Path

from config.schema import Settings, TissueLibrary, Tool


@dataclass(frozen=True, slots=True)
class ServicePlan:
    """`data` is the folder for everything that is kept. `recorded_with` is the tool file of recordings that
    name none. `tool_source` is what the tool was called by: its name, or its file.

    With `opened` there is no tool: the service only shows these recordings. `demo` repeats a protocol on each tissue in
    turn.
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
