"""Files that are written whole or not at all, also when the program ends while it writes."""

from pathlib import Path

import pytest

from config.atomic_write import open_atomically


@pytest.mark.parametrize("overwrite", [True, False])
def test_an_end_by_a_signal_leaves_what_was_there(tmp_path: Path, overwrite: bool) -> None:
    path, before = tmp_path / "a.txt", ["old"] * overwrite
    for text in before:
        path.write_text(text)
    with pytest.raises(SystemExit), open_atomically(path, overwrite=overwrite) as file:  # as after SIGTERM
        file.write(b"half")
        raise SystemExit(143)
    assert [each.read_text() for each in tmp_path.iterdir()] == before


def test_without_overwriting_a_file_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(FileExistsError), open_atomically(path, overwrite=False):
        pass
    assert [each.read_text() for each in tmp_path.iterdir()] == ["old"]
