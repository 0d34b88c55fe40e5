"""The class StudyResult: figures with targets, tables and plots, written as a self-contained HTML page and as JSON."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
import plotly.io
from markupsafe import Markup

from config.atomic_write import write_atomically
from estimator.studies.html_page import Table, format_value, render_template, to_json_value

PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999", "#000000")


@dataclass(frozen=True, slots=True)
class KeyFigure:
    """One number of a study, with its target `at_most` or `at_least`, if it has one."""

    name: str
    value: float | None
    unit: str = ""
    at_most: float | None = None
    at_least: float | None = None
    note: str = ""

    @property
    def reached(self) -> bool | None:
        """Whether the target is reached; None without a target."""
        if self.at_most is None and self.at_least is None:
            return None
        if self.value is None:
            return False
        return bool(
            (self.at_most is None or self.value <= self.at_most)
            and (self.at_least is None or self.value >= self.at_least)
        )

    @property
    def floor(self) -> str:
        """The target in words; empty without a target."""
        if self.at_most is not None:
            return f"at most {self.at_most:g} {self.unit}".rstrip()
        return "" if self.at_least is None else f"at least {self.at_least:g} {self.unit}".rstrip()


@dataclass(slots=True)
class StudyResult:
    """A study's result; its fields stand in the order in which the page shows them."""

    name: str
    title: str
    settings: dict[str, Any]
    explanation: str
    figures: list[KeyFigure] = field(default_factory=list)
    parts: list[Table | tuple[str, go.Figure]] = field(default_factory=list)

    def to_document(self) -> dict[str, Any]:
        """Return all figures and tables, ready for JSON: no NaN, no infinity."""
        return {
            "study": self.name,
            "settings": to_json_value(self.settings),
            "figures": [
                {**to_json_value(asdict(figure)), "floor": figure.floor, "reached": figure.reached}
                for figure in self.figures
            ],
            "tables": [to_json_value(asdict(part)) for part in self.parts if isinstance(part, Table)],
        }

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write `study-NAME.html` and `study-NAME.json` into `folder`; return both paths.

        Raises:
            OSError: a file cannot be written.
        """
        folder.mkdir(parents=True, exist_ok=True)
        page, data = folder / f"study-{self.name}.html", folder / f"study-{self.name}.json"
        write_atomically(page, self.render_page())
        write_atomically(data, json.dumps(self.to_document(), indent=2, allow_nan=False) + "\n")
        return page, data

    def render_page(self) -> str:
        """Return the report as one self-contained HTML page."""
        parts: list[Table | dict[str, str]] = [_build_figures_table(self.figures)]
        first = True
        for part in self.parts:
            if isinstance(part, Table):
                parts.append(part)
                continue
            title, figure = part
            figure.update_layout(template="plotly_white", margin={"l": 60, "r": 20, "t": 30, "b": 50}, height=420)
            plot = plotly.io.to_html(figure, full_html=False, include_plotlyjs=first, config={"displaylogo": False})
            parts.append({"title": title, "plot": Markup(plot)})
            first = False
        return render_template(
            "study.html.jinja",
            kind="Graspwatch study",
            title=self.title,
            settings=self.settings,
            explanation=self.explanation,
            parts=parts,
        )


def _build_figures_table(figures: list[KeyFigure]) -> Table:
    words = {True: "reached", False: Markup('<span class="missed">not reached</span>'), None: ""}
    content = [
        [f.name, f"{format_value(f.value)} {f.unit}".rstrip(), f.floor, words[f.reached], f.note] for f in figures
    ]
    return Table("Figures", ["Figure", "Measured", "To reach", "Reached?", "Note"], content)
