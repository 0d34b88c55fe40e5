"""The server loads no library that only its workers and background processes need: that costs memory and a second."""

import subprocess
import sys

import pytest

LIBRARIES_OF_OTHER_PROCESSES = ("numba", "scipy", "pyarrow", "plotly", "matplotlib")


@pytest.mark.parametrize("module", ["app.api.app", "app.cli.serve"])
def test_the_server_loads_no_library_of_other_processes(module: str) -> None:
    code = f"import {module}, sys; print(*(set({LIBRARIES_OF_OTHER_PROCESSES}) & set(sys.modules)))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.split() == []
