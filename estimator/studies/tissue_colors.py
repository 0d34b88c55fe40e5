"""The function that gives each tissue its color on pages of studies and in reports, as on the dashboard."""

from collections.abc import Iterable

PALETTE = ("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#0072b2", "#f0e442", "#d55e00")
"""Okabe and Ito's palette, in the dashboard's order (`frontend/src/styles/theme.css`)."""
UNKNOWN_COLOR = "#808b94"
OWN_COLORS = dict(zip(("liver", "small_bowel", "bladder", "gallbladder"), PALETTE, strict=False))
"""The tissues of the shipped library keep their colors in every library."""


def assign_tissue_colors(names: Iterable[str]) -> dict[str, str]:
    """Return a color for each name; no two are alike while there are free ones. `frontend/src/tissues.ts` has the same.

    A name's first choice is the same in every library.
    """
    names = list(names)
    colors = {name: OWN_COLORS[name] for name in names if name in OWN_COLORS}
    for name in sorted(set(names) - colors.keys()):
        free = [color for color in PALETTE if color not in colors.values()] or list(PALETTE)
        preferred = [color for color in free if color not in OWN_COLORS.values()] or free
        colors[name] = preferred[sum(map(ord, name)) % len(preferred)]
    return colors
