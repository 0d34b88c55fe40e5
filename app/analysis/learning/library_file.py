"""Atomic writing of library and report files."""

import contextlib
import os
import tempfile
from pathlib import Path

import tomli_w

from config.errors import ConfigurationError
from config.schema import TissueLibrary


def check_writable(path: Path) -> None:
    """Check, before the work begins, that a library file can be written at `path`.

    Raises:
        ConfigurationError: it cannot; the text says why.
    """
    if path.is_dir():
        raise ConfigurationError(f"{path}: is a folder. Name the file to write with --out, for example library.toml.")
    if path.suffix != ".toml":
        raise ConfigurationError(f"{path}: a library's name ends in .toml. Name it so with --out.")
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise ConfigurationError(
            f"{path}: cannot be written ({error.strerror}). Make the folder, or name another place with --out."
        ) from None


def library_to_toml(library: TissueLibrary) -> str:
    """Convert a library to the TOML text of its file."""
    return tomli_w.dumps(library.model_dump(mode="json", exclude_none=True))


def write_atomically(path: Path, text: str) -> None:
    """Write a text file whole or not at all, through a temporary file in the same folder.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    unfinished: str | None = None
    try:
        handle, unfinished = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(unfinished, 0o666 & ~_umask())
        os.replace(unfinished, path)
    except OSError as error:
        if unfinished:
            with contextlib.suppress(OSError):
                os.unlink(unfinished)
        raise ConfigurationError(
            f"{path}: cannot be written ({error.strerror}). Free some space, or name another place with --out."
        ) from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
