import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small: threads would only wait for each other

from collections.abc import Callable, Generator
from pathlib import Path

import hypothesis
import pytest
from reactions import Reactions

from config.load import load_grasp_protocol, load_library, load_settings, load_tool
from config.schema import GraspProtocol, Settings, TissueLibrary, Tool

CHECKOUT = Path(__file__).parents[1]

# an example's duration depends on other load of the machine; the benchmarks measure speed
hypothesis.settings.register_profile("unhurried", hypothesis.settings(), deadline=None)
hypothesis.settings.load_profile("unhurried")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--reactions", type=Path, help="Append to this file, one JSON a line: reaction times, outcomes.")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.when == "call":
        reactions_of(item).outcome(report.passed)
        if report.failed and item.get_closest_marker("alone"):
            load = ", ".join(f"{each:.1f}" for each in os.getloadavg())
            text = f"load over 1, 5 and 15 minutes: {load}, on {os.cpu_count()} cores. Repeat it on a machine at rest."
            report.sections.append(("The machine", text))
    return report


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run browser tests alone: without a GPU a page takes one core, and its live tool most of another."""
    for item in items:
        if item.get_closest_marker("browser"):
            item.add_marker(pytest.mark.alone)


def reactions_of(item: pytest.Item) -> Reactions:
    return Reactions(item.nodeid.partition("[")[0], item.config.getoption("--reactions"))


@pytest.fixture
def reactions(request: pytest.FixtureRequest) -> Reactions:
    return reactions_of(request.node)


@pytest.fixture(scope="session")
def tool() -> Tool:
    return load_tool("simulated")


@pytest.fixture(scope="session")
def recording_tool() -> Tool:
    return load_tool("smart_tool_2013")


@pytest.fixture(scope="session")
def library() -> TissueLibrary:
    return load_library("porcine")


@pytest.fixture(scope="session")
def settings() -> Settings:
    return load_settings()


@pytest.fixture(scope="session")
def protocol() -> Callable[[str], GraspProtocol]:
    return load_grasp_protocol


@pytest.fixture(scope="session")
def recordings() -> list[Path]:
    """Return the third-party recordings of the real tool; they are not part of this project."""
    folder = Path(os.environ.get("GRASPWATCH_RECORDINGS", CHECKOUT / "../shared/recordings")).resolve()
    found = sorted(folder.glob("*.lvm*"))
    if not found:
        pytest.skip(f"no recordings of the real tool in {folder}; set GRASPWATCH_RECORDINGS to their folder")
    return found
