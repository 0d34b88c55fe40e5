"""Own files in one folder: names, versions, what is in use, and many threads at once."""

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from app.service.configuration_files import ConfigurationFiles, NoSuchFileError
from app.service.runs import RunRegistry
from config.errors import RefusedError
from config.load import CONFIG_DIR, MAX_NAME_LENGTH, FileKind, load_library, load_settings, load_tool
from config.service_plan import ServicePlan

SINE = (CONFIG_DIR / "protocols/sine.toml").read_text()
TOOL = (CONFIG_DIR / "tools/simulated.toml").read_text()
LIBRARY = (CONFIG_DIR / "tissues/porcine.toml").read_text()


def named(text: str, name: str) -> str:
    """A text with another name in it."""
    first = next(line for line in text.splitlines() if line.startswith("name = "))
    return text.replace(first, f'name = "{name}"', 1)


def open_files(data: Path, calibration_source: str = "simulated", **settings: str) -> ConfigurationFiles:
    tool, library = load_tool("simulated"), load_library("porcine")
    chosen = load_settings().model_copy(update=settings)
    plan = ServicePlan(tool, library, chosen, "liver", 0, data, tool, tool_source=settings.get("started", "simulated"))
    return ConfigurationFiles(plan, RunRegistry(plan), lambda: calibration_source)


def test_a_text_replaces_only_the_file_that_it_was_and_answers_with_its_own_version(tmp_path: Path) -> None:
    files = open_files(tmp_path)
    first = files.save(FileKind.PROTOCOL, named(SINE, "mine"), None)
    other = named(SINE, "mine") + "# changed\r\n"
    second = files.save(FileKind.PROTOCOL, other, first.version)
    assert second.version == files.read(FileKind.PROTOCOL, "mine").version != first.version
    with pytest.raises(RefusedError, match="somebody has changed it"):
        files.save(FileKind.PROTOCOL, named(SINE, "mine"), first.version)
    files.delete(FileKind.PROTOCOL, "mine")
    with pytest.raises(RefusedError, match="no own protocol 'mine' any more"):  # it was deleted meanwhile
        files.save(FileKind.PROTOCOL, named(SINE, "mine"), second.version)
    files.save(FileKind.TOOL, named(TOOL, "bench"), None)
    dated = tmp_path / "tools/bench-2026-10-01.toml"
    (tmp_path / "tools/bench.toml").rename(dated)
    with pytest.raises(RefusedError, match="no own tool 'bench' any more"):
        files.save(FileKind.TOOL, named(TOOL, "bench"), files.read(FileKind.TOOL, dated.stem).version)
    assert [each.name for each in files.list_files().files if not each.shipped] == [dated.stem]


def test_each_file_can_be_deleted_but_none_that_the_next_start_or_calibration_needs(tmp_path: Path) -> None:
    library, started = (str(tmp_path / each) for each in ("tissues/mine.toml", "tools/at.toml"))
    files = open_files(tmp_path, str(tmp_path / "tools/base.toml"), tool="mine", library=library, started=started)
    for kind, text in ((FileKind.TOOL, TOOL), (FileKind.LIBRARY, LIBRARY), (FileKind.PROTOCOL, SINE)):
        for name in ("mine", "at", "base", "free"):
            saved = files.save(kind, named(text, name), None)
            kept = name in {FileKind.TOOL: ("mine", "at", "base"), FileKind.LIBRARY: ("mine",)}.get(kind, ())
            assert (saved.file.in_use is not None) == kept, (kind, name)
            if not kept:
                files.delete(kind, name)
                continue
            for change in (lambda: files.delete(kind, name), lambda: files.save(kind, saved.text, saved.version)):  # noqa: B023
                with pytest.raises(RefusedError, match="Save yours under another `name`"):
                    change()
    folder = tmp_path / "protocols"
    (folder / "broken.toml").write_bytes(b"\xff\xfe")
    (folder / "sine.toml").write_text(SINE + "# own\n")
    files.delete(FileKind.PROTOCOL, "broken")
    shipped = files.read(FileKind.PROTOCOL, "sine")
    assert (shipped.file.shipped, shipped.text) == (True, SINE)  # as in a start
    files.delete(FileKind.PROTOCOL, "sine")
    assert not list(folder.iterdir())
    with pytest.raises(RefusedError, match="is a shipped protocol"):
        files.delete(FileKind.PROTOCOL, "sine")
    with pytest.raises(NoSuchFileError):
        files.delete(FileKind.PROTOCOL, "broken")


@pytest.mark.parametrize("text", [SINE, TOOL, LIBRARY], ids=["protocol", "tool", "library"])
def test_a_name_fits_into_a_file_name(text: str, tmp_path: Path) -> None:
    files = open_files(tmp_path)
    kind = {SINE: FileKind.PROTOCOL, TOOL: FileKind.TOOL, LIBRARY: FileKind.LIBRARY}[text]
    assert files.save(kind, named(text, "n" * MAX_NAME_LENGTH), None).file.problems == []
    for length in (MAX_NAME_LENGTH + 1, 300):
        [problem] = files.check(kind, named(text, "n" * length)).problems
        assert problem == f"name: has {length} characters; at most 64 are allowed. Shorten it."


def test_lists_are_whole_while_files_come_and_go(tmp_path: Path) -> None:
    files, folder = open_files(tmp_path), tmp_path / "protocols"
    folder.mkdir()
    rounds = 50

    def change(worker: int) -> None:
        for number in range(rounds):
            path = folder / f"p{worker}.toml"
            path.write_text(named(SINE, path.stem) + f"# {number}\n")
            os.utime(path, ns=(number, number))
            if number % 10 == 9:
                path.unlink()

    def look(_: int) -> None:
        for _ in range(rounds):
            assert all(each.title or each.problems for each in files.list_files().files)
            assert {"sine", "staircase"} <= {path.stem for path, _ in files.list_readable_protocols()}

    usual_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # threads meet at every step
    try:
        with ThreadPoolExecutor(8) as pool:
            done = [pool.submit(work, worker) for worker in range(4) for work in (change, look)]
            for each in done:
                each.result()
    finally:
        sys.setswitchinterval(usual_s)
