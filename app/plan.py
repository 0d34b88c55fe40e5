"""What a service is to be: decided once from the command line and the configuration, then handed to every part."""

from dataclasses import dataclass
from pathlib import Path

from config.schema import Settings, TissueLibrary, Tool


@dataclass(frozen=True, slots=True)
class ServicePlan:
    """`recordings` are shown instead of a tool; `demo` repeats a protocol on each tissue in turn."""

    tool: Tool
    library: TissueLibrary
    settings: Settings
    tissue: str
    seed: int
    recordings: tuple[Path, ...] = ()
    speed: float = 1.0
    demo: bool = False
