"""Room on the disk."""

import shutil
from pathlib import Path


def free_bytes(folder: Path) -> int | None:
    """Of the disk of a folder; None where the folder is gone."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None
