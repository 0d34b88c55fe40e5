"""Functions for the file of a learned library: whether it can be written, and its text."""

import tempfile
from pathlib import Path

import tomlkit

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
    """Return the TOML text of a library's file."""
    return tomlkit.dumps(library.model_dump(mode="json", exclude_none=True))
