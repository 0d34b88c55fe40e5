"""The function that gives each tissue its color and abbreviation, as on the dashboard."""

from dataclasses import dataclass

from config.schema import TissueLibrary
from estimator.decision import NO_ANSWER, UNDECIDED, UNKNOWN
from estimator.force_alarms import Priority
from estimator.studies.tissue_colors import UNKNOWN_COLOR, assign_tissue_colors

LIGHT_TEXT_ON = {"#0072b2"}  # on all other colors text is black
UNKNOWN_COLORS, UNDECIDED_COLORS = (UNKNOWN_COLOR, "#000000"), ("#c3ccd4", "#000000")
ALARM_COLORS = {Priority.LOW: "#00d5f0", Priority.MEDIUM: "#ffd400", Priority.HIGH: "#d40020"}


@dataclass(frozen=True, slots=True)
class TissueStyle:
    """Name and look of a tissue or other group; `text_color` is for text on `color`."""

    name: str
    title: str
    abbreviation: str
    color: str
    text_color: str


def build_tissue_styles(library: TissueLibrary, groups: tuple[str, ...] = ()) -> dict[str, TissueStyle]:
    """Build styles for the tissues, *unknown*, *undecided*, *no answer*, and other groups that a report names."""
    titles = {name: profile.title for name, profile in library.tissues.items()}
    others = [name for name in groups if name not in (*titles, UNKNOWN, UNDECIDED, NO_ANSWER)]
    titles |= {name: name.replace("_", " ").capitalize() for name in others}
    colors = assign_tissue_colors(titles)
    looks = {
        name: TissueStyle(
            name,
            title,
            _abbreviate(title, [*titles.values()]),
            colors[name],
            "#ffffff" if colors[name] in LIGHT_TEXT_ON else "#000000",
        )
        for name, title in titles.items()
    }
    looks[UNKNOWN] = TissueStyle(UNKNOWN, "Unknown", "?", *UNKNOWN_COLORS)
    looks[UNDECIDED] = TissueStyle(UNDECIDED, "Undecided", "–", *UNDECIDED_COLORS)
    looks[NO_ANSWER] = TissueStyle(NO_ANSWER, "No answer", "×", *UNDECIDED_COLORS)
    return looks


def _abbreviate(title: str, titles: list[str]) -> str:
    """Return the title's initials, or if they are taken, its shortest beginning that no other title shares."""
    others = [other for other in titles if other != title]
    if _initials(title) not in map(_initials, others):
        return _initials(title)
    lengths = range(2, len(title))
    return next((title[:n] for n in lengths if not any(other.startswith(title[:n]) for other in others)), title)


def _initials(title: str) -> str:
    return "".join(word[0].upper() for word in title.split())
