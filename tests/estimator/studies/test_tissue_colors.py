"""Colors of tissues: alike on the dashboard, in reports and on pages of studies."""

import itertools
import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.studies.tissue_colors import TISSUE_PALETTE, assign_tissue_colors

SLOTS = Path(__file__).parents[3] / "frontend/tests/tissue-slots.json"
THEME = Path(__file__).parents[3] / "frontend/src/styles/theme.css"


@given(st.lists(st.text("abcdefg_", min_size=1), max_size=7, unique=True))
def test_seven_tissues_have_seven_colors(names: list[str]) -> None:
    assert len({*assign_tissue_colors(names).values()}) == len(names)


@given(st.lists(st.text("abcdefg_", min_size=1), max_size=6))
def test_the_shipped_tissues_keep_their_colors(others: list[str]) -> None:
    colors = assign_tissue_colors([*others, "bladder", "liver"])
    assert (colors["liver"], colors["bladder"]) == (TISSUE_PALETTE[0], TISSUE_PALETTE[2])
    assert assign_tissue_colors(["spleen"])["spleen"] == assign_tissue_colors(["liver", "spleen"])["spleen"]


def test_a_color_is_lost_only_to_another_tissue_with_the_same_first_choice() -> None:
    alone = {name: assign_tissue_colors([name])[name] for name in ("fat", "kidney", "spleen", "lung", "pancreas")}
    for name, other in itertools.combinations(alone, 2):
        if alone[name] != alone[other]:
            assert assign_tissue_colors([name, other]) == {name: alone[name], other: alone[other]}


@pytest.mark.parametrize("slots", json.loads(SLOTS.read_text()))
def test_the_dashboard_gives_the_same_colors(slots: dict[str, str]) -> None:
    colors = assign_tissue_colors(slots)  # the dashboard's own test reads the same file
    assert {name: str(TISSUE_PALETTE.index(color) + 1) for name, color in colors.items()} == slots


def test_the_palette_is_the_dashboards() -> None:
    theme = THEME.read_text()
    slots = [re.search(rf"--tissue-{slot}:\s*(#\w+)", theme) for slot in range(1, 8)]
    assert [found and found[1] for found in slots] == [*TISSUE_PALETTE]
