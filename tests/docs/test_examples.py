"""The example notebooks, executed from the first cell to the last against a real service."""

import os
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from service import Service

LONG = {"recordings"}
EXAMPLES = [
    pytest.param(path, id=path.stem, marks=[pytest.mark.long] * (path.stem in LONG))
    for path in sorted((Path(__file__).parents[2] / "docs/examples").glob("*.ipynb"))
]


@pytest.mark.alone  # a kernel and its plots take a core while the tool, which must not be starved, grasps
@pytest.mark.parametrize("path", EXAMPLES)
def test_a_notebook_runs(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    notebook = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "clear the outputs before you commit a notebook"
    with Service("serve") as service:
        monkeypatch.setenv("GRASPWATCH_URL", service.url)
        NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert any("image/png" in output.get("data", {}) for output in outputs)
