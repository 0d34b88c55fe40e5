"""How this package's functions are compiled, and when what was compiled before is not believed any more."""

from pathlib import Path

from numba import njit


def remove_stale_cache(package: Path) -> None:
    """Remove compiled functions that are older than any source of the package.

    Numba's cache looks at a function's own file only; here constants and helpers come from other files of the package.
    """
    newest = max(path.stat().st_mtime for path in package.rglob("*.py"))
    for index in package.rglob("__pycache__/*.nbi"):
        try:
            if index.stat().st_mtime < newest:
                index.unlink()
        except (
            OSError
        ):  # another process was faster, or the files are somebody else's, who renews them with the package
            continue


remove_stale_cache(Path(__file__).parent)

# Division by zero gives infinity, and the filter is then found to have diverged; it must not raise between two samples.
compiled = njit(cache=True, error_model="numpy")
