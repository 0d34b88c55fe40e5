"""Functions for the names of recordings: their endings, and the rules for a run's name."""

import unicodedata
from pathlib import Path

from config.errors import ConfigurationError

RECORDING_SUFFIXES = (".mcap", ".lvm.gz", ".lvm")  # longer ones before those that they end with
TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".tdms", ".mat", ".parquet", ".pq")  # of other programs' recordings
PACKED_SUFFIX = ".gz"
DEMO_ID_PREFIX = "demo-"  # of the id of a demonstration's run; the recorder deletes old ones
REFERENCE_ID_PREFIX = "reference-"  # of the id of a run that is a reference grasp: it holds no tissue
MAX_NAME_BYTES = 200  # with endings and additions of files beside it, a file system's 255 are not passed


def is_reference_run(run_id: str) -> bool:
    """Return whether a run is a reference grasp, whose jaws are empty."""
    return run_id.startswith(REFERENCE_ID_PREFIX)


def list_run_files(folder: Path) -> list[Path]:
    """Return the MCAP recordings in a folder, by name, without those of demonstrations.

    A link out of the folder is left out, and so is what is no file, or has a name that cannot be printed.
    """
    folder = folder.resolve()
    found = (path for path in folder.glob("*.mcap") if not path.name.startswith(DEMO_ID_PREFIX))
    return sorted(
        path for path in found if path.name.isprintable() and path.is_file() and path.resolve().parent == folder
    )


def has_recording_suffix(name: str) -> bool:
    """Return whether a file's name has the ending of an MCAP file or a LabVIEW log, in small or capital letters."""
    return name.lower().endswith(RECORDING_SUFFIXES)


def has_table_suffix(name: str) -> bool:
    """Return whether a file's name has the ending of a table of another program, which may be packed by gzip."""
    return name.lower().removesuffix(PACKED_SUFFIX).endswith(TABLE_SUFFIXES)


def remove_recording_suffix(name: str) -> str:
    """Return a file's name without the ending of a recording; all other points are part of the name."""
    tables = (suffix + packed for packed in (PACKED_SUFFIX, "") for suffix in TABLE_SUFFIXES)
    suffix = next((suffix for suffix in (*RECORDING_SUFFIXES, *tables) if name.lower().endswith(suffix)), "")
    return name[: len(name) - len(suffix)]


def to_printable(text: str) -> str:
    """Return the text with an escape for each byte that is no UTF-8; a file's name may have such bytes."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def check_run_name(name: str, advice: str) -> str:
    """Return the name unchanged if a run and its file can have it.

    It may have all letters, signs and spaces, but nothing that a file system, an address or a shell takes for
    something else.

    Raises:
        ConfigurationError: it cannot be the name of a run; the text ends with `advice`.
    """
    if not name.strip():
        why = "it is empty"
    elif to_printable(name) != name:
        why = "it is not UTF-8"
    elif not name.isprintable():
        why = "it has a character that cannot be printed"
    elif "/" in name or "\\" in name:
        why = "it has a slash"
    elif name != name.strip():
        why = "it begins or ends with a space"
    elif name[0] in ".-":
        why = f"it begins with {name[0]!r}"
    elif name.startswith(DEMO_ID_PREFIX):
        why = f"{DEMO_ID_PREFIX!r} is kept for demonstrations, whose old recordings are deleted"
    elif is_reference_run(name):
        why = f"{REFERENCE_ID_PREFIX!r} is kept for reference grasps, which hold no tissue"
    elif len(unicodedata.normalize("NFD", name).encode()) > MAX_NAME_BYTES:
        why = f"it has more than {MAX_NAME_BYTES} bytes"
    else:
        return name
    raise ConfigurationError(f"'{to_printable(name)[:80]}' cannot be the name of a recording: {why}. {advice}")
