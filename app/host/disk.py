"""The function that returns how much disk space is free."""

import shutil
from pathlib import Path


def free_bytes(folder: Path) -> int | None:
    """Return the free space on a folder's disk, bytes; None if the folder is missing."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None
