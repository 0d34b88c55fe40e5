from pathlib import Path

import pytest

from config.load import load_tool
from config.schema import Settings, TissueLibrary, Tool
from config.service_plan import ServicePlan


@pytest.fixture
def plan(tool: Tool, library: TissueLibrary, settings: Settings, tmp_path: Path) -> ServicePlan:
    (tmp_path / "recordings").mkdir()
    return ServicePlan(tool, library, settings, "liver", 0, tmp_path, load_tool("smart_tool_2013"))
