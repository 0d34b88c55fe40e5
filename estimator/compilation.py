"""Compile this package's functions, and remove compiled functions that are out of date."""

from pathlib import Path

from numba import njit


def remove_stale_cache(package: Path) -> None:
    """Remove compiled functions that are older than any source of the package.

    Numba's cache checks only the function's own file, but constants and helpers come from other files of the package.
    """
    newest = max(path.stat().st_mtime for path in package.rglob("*.py"))
    for index in package.rglob("__pycache__/*.nbi"):
        try:
            if index.stat().st_mtime < newest:
                index.unlink()
        except OSError:
            # Another process removed it first, or the files belong to another user, who updates them with the package.
            continue


remove_stale_cache(Path(__file__).parent)

# Division by zero gives infinity and does not raise; `is_healthy` then finds that the filter has diverged.
compiled = njit(cache=True, error_model="numpy")
