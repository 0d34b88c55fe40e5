"""Colors of tissues: alike on the dashboard, in reports and on pages of studies."""

import re
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from estimator.studies.tissue_colors import PALETTE, assign_tissue_colors

THEME = Path(__file__).parents[3] / "frontend/src/styles/theme.css"


@given(st.lists(st.text("abcdefg_", min_size=1), max_size=7, unique=True))
def test_seven_tissues_have_seven_colors(names: list[str]) -> None:
    assert len({*assign_tissue_colors(names).values()}) == len(names)


@given(st.lists(st.text("abcdefg_", min_size=1), max_size=6))
def test_the_shipped_tissues_keep_their_colors(others: list[str]) -> None:
    colors = assign_tissue_colors([*others, "bladder", "liver"])
    assert (colors["liver"], colors["bladder"]) == (PALETTE[0], PALETTE[2])
    assert assign_tissue_colors(["spleen"])["spleen"] == assign_tissue_colors(["liver", "spleen"])["spleen"]


def test_the_palette_is_the_dashboards() -> None:
    theme = THEME.read_text()
    slots = [re.search(rf"--tissue-{slot}:\s*(#\w+)", theme) for slot in range(1, 8)]
    assert [found and found[1] for found in slots] == [*PALETTE]
