"""The function that gives each tissue its color on pages of studies and in reports, as on the dashboard."""

from collections.abc import Iterable

TISSUE_PALETTE = ("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#0072b2", "#f0e442", "#d55e00")
"""Okabe and Ito's palette, in the dashboard's order (`frontend/src/styles/theme.css`)."""
UNKNOWN_COLOR = "#808b94"
SHIPPED_TISSUE_COLORS = dict(zip(("liver", "small_bowel", "bladder", "gallbladder"), TISSUE_PALETTE, strict=False))
"""The tissues of the shipped library keep their colors in every library."""


def assign_tissue_colors(names: Iterable[str]) -> dict[str, str]:
    """Return a color for each name, as `frontend/src/tissues.ts` does.

    A name keeps its first choice unless another one before it in the alphabet has taken it. No two are alike while
    there are free colors.
    """
    names = list(names)
    shipped = list(SHIPPED_TISSUE_COLORS.values())
    choices = [*(color for color in TISSUE_PALETTE if color not in shipped), *shipped]
    first_choices = len(choices) - len(shipped)
    colors = {name: SHIPPED_TISSUE_COLORS[name] for name in names if name in SHIPPED_TISSUE_COLORS}
    for name in sorted(set(names) - colors.keys()):
        first = sum(map(ord, name)) % first_choices
        in_turn = choices[first:] + choices[:first]
        taken = set(colors.values())
        colors[name] = next((color for color in in_turn if color not in taken), in_turn[0])
    return colors
