"""A recorded run for the tests of this folder."""

from pathlib import Path

import pytest

from app.analysis.headless import run_protocol
from config.load import load_grasp_protocol, load_library, load_settings, load_tool


def record(path: Path, tissue: str = "liver", cycles: int = 2) -> Path:
    run_protocol(
        load_tool("simulated"),
        load_library("porcine"),
        load_settings(),
        load_grasp_protocol("strong_2hz"),
        tissue,
        cycles=cycles,
        seed=3,
        real_time=False,
        recording_path=path,
        progress=lambda _: None,
    )
    return path


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two grasps that are held back."""
    return record(tmp_path_factory.mktemp("recorded") / "held.mcap")
