"""Writing of files whole or not at all."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

SMALLEST_FILE_BYTES = 4096


@contextlib.contextmanager
def open_atomically(path: Path, *, private: bool = False, overwrite: bool = True) -> Iterator[BinaryIO]:
    """Open a file to be written whole or not at all; after the block it is on the disk.

    The content goes to a temporary file in the same folder, which is removed at any error and at a signal that ends the
    program. `private`: other users may not read the file, at no moment. Without `overwrite` an empty file takes the
    name while the content is written.

    Raises:
        OSError: the file cannot be written; FileExistsError: it exists, without `overwrite`.
    """
    unfinished = None
    if not overwrite:
        path.open("xb").close()
    try:
        handle, unfinished = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")  # mode 0600
        with os.fdopen(handle, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if not private:
            os.chmod(unfinished, 0o666 & ~_umask())
        os.replace(unfinished, path)
    except BaseException:
        if unfinished:
            Path(unfinished).unlink(missing_ok=True)
        if not overwrite:
            path.unlink(missing_ok=True)
        raise


def write_atomically(path: Path, text: str, *, private: bool = False, overwrite: bool = True) -> None:
    """Write a text file as `open_atomically` does."""
    with open_atomically(path, private=private, overwrite=overwrite) as file:
        file.write(text.encode())


def check_writable(folder: Path) -> None:
    """Make a folder if it is missing, and check that files can be written to it.

    Raises:
        OSError: the folder cannot be made or written to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder) as file:
        file.write(bytes(SMALLEST_FILE_BYTES))  # a full disk takes an empty file


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
