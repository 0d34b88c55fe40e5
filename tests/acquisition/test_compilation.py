"""The cache of compiled functions: no state of it stops the program, changes a result, or makes a folder of its own."""

import errno
import importlib.util
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest

from acquisition import compilation

SOURCE = "from acquisition.compilation import compiled\n\n\n@compiled\ndef double(x):\n    return 2 * x\n"
DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "cut off": lambda content: content[: len(content) // 2],
    "one bit": lambda content: content[:-9] + bytes([content[-9] ^ 1]) + content[-8:],
    "other content": lambda _: b"\x80\x04N." * 50,
}


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Any]:
    """Return a function that imports the source anew, as the next start of the program does."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "doubling.py"
    path.write_text(SOURCE)

    def load_anew() -> Any:
        compilation.warn_once.cache_clear()
        spec = importlib.util.spec_from_file_location("doubling", path)
        assert spec
        assert spec.loader
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.double

    return load_anew


def hits(double: Any) -> int:
    assert double(21) == 42
    return sum(double.stats.cache_hits.values())


def test_a_damaged_cache_is_told_once_and_made_anew(
    load: Callable[[], Any], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert (hits(load()), hits(load())) == (0, 1)
    files = [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]
    assert files
    for path in files:
        for name, damage in DAMAGES.items():
            caplog.clear()
            path.write_bytes(damage(path.read_bytes()))
            assert hits(load()) == 0, name
            assert [record.message.endswith("is damaged; it is made anew.") for record in caplog.records] == [True]
            caplog.clear()
            assert (hits(load()), caplog.records) == (1, []), name


def test_another_source_of_the_program_makes_it_out_of_date(
    load: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (hits(load()), hits(load())) == (0, 1)
    monkeypatch.setattr(compilation, "hash_sources", lambda: "of another version")
    assert (hits(load()), hits(load())) == (0, 1)


def test_code_of_another_version_is_not_executed_though_the_new_one_could_not_be_saved(
    load: Callable[[], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The bytecode of both versions is the same: constants are no part of it."""
    assert (hits(load()), hits(load())) == (0, 1)
    monkeypatch.setattr(compilation, "hash_sources", lambda: "of another version")
    (tmp_path / "doubling.py").write_text(SOURCE.replace("2 *", "1000 *"))
    with monkeypatch.context() as full_disk:
        full_disk.setattr(os, "fsync", fail_on_full_disk)
        assert load()(21) == 21_000
    assert "No space left" in caplog.text
    assert load()(21) == 21_000


def fail_on_full_disk(_: int) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_code_of_another_signature_is_not_executed(load: Callable[[], Any], tmp_path: Path) -> None:
    """Each signature has a file; two programs at once cannot mix them up, and exchanged ones are noticed."""
    for values in ((21, 0.5), (0.5, 21)):
        assert [load()(value) for value in values] == [2 * value for value in values]
    one, other = (tmp_path / "cache").rglob("*.nbc")
    exchanged = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(exchanged)
    double = load()
    assert (hits(double), double(0.5)) == (0, 1.0)
    assert (hits(load()), load()(0.5)) == (1, 1.0)


@pytest.mark.parametrize("fault", ["mode", "owner"])
def test_a_folder_that_others_can_write_to_is_not_used(load: Callable[[], Any], tmp_path: Path, fault: str) -> None:
    assert (hits(load()), hits(load())) == (0, 1)
    folder = next((tmp_path / "cache").iterdir())
    if fault == "mode":
        folder.chmod(0o777)
    else:
        os.chown(folder, 54321, -1)
    assert (hits(load()), hits(load())) == (0, 1)
    assert list((tmp_path / "__pycache__").glob("*.nbc"))


def test_a_cache_that_cannot_be_written_is_told_once(
    load: Callable[[], Any], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    double = load()
    folder = next((tmp_path / "cache").iterdir())
    folder.rmdir()
    folder.write_text("a file in its place")
    with caplog.at_level(logging.WARNING):
        assert hits(double) == 0
    [record] = caplog.records
    assert "cannot be kept" in record.message


def test_without_any_place_it_compiles_says_so_once_and_makes_no_folder(tmp_path: Path) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "doubling.py").write_text(SOURCE + "\n\n@compiled\ndef triple(x):\n    return 3 * x\n")
    (program / "__pycache__").write_text("no folder")
    done = subprocess.run(
        [sys.executable, "-c", "import doubling; print(doubling.double(21), doubling.triple(2))"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"PATH": os.environ["PATH"], "HOME": "/proc/none", "PYTHONPATH": f"{program}:{Path.cwd()}"},
    )
    assert done.stdout == "42 6\n", done.stderr
    assert done.stderr.count("Set NUMBA_CACHE_DIR") == 1, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["program"]
