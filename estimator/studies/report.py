"""A study's outcome: figures with their floors, tables and plots, as one self-contained HTML page and as JSON."""

import html
import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
import plotly.io

# Okabe and Ito's palette, as on the dashboard
COLOURS = {
    "liver": "#d55e00", "small_bowel": "#e69f00", "bladder": "#0072b2", "gallbladder": "#009e73", "unknown": "#999999",
}  # fmt: skip
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999", "#000000")


@dataclass(frozen=True, slots=True)
class Figure:
    """One number of a study. `at_most` or `at_least` is the floor that it is to reach, if there is one."""

    name: str
    value: float | None
    unit: str = ""
    at_most: float | None = None
    at_least: float | None = None
    note: str = ""

    @property
    def reached(self) -> bool | None:
        """Whether the floor is reached; None where there is none."""
        if self.at_most is None and self.at_least is None:
            return None
        if self.value is None:
            return False
        return (self.at_most is None or self.value <= self.at_most) and (
            self.at_least is None or self.value >= self.at_least
        )

    @property
    def floor(self) -> str:
        """The floor in words; empty where there is none."""
        if self.at_most is not None:
            return f"at most {self.at_most:g} {self.unit}".rstrip()
        return "" if self.at_least is None else f"at least {self.at_least:g} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class Table:
    """A table of numbers and words; numbers are shown with three significant digits."""

    title: str
    columns: list[str]
    rows: list[list[Any]]


@dataclass(slots=True)
class Study:
    """What a study found, in the order in which it is to be read."""

    name: str
    title: str
    settings: dict[str, Any]
    explanation: str
    figures: list[Figure] = field(default_factory=list)
    parts: list[Table | tuple[str, go.Figure]] = field(default_factory=list)

    def document(self) -> dict[str, Any]:
        """All figures and tables, ready for JSON: no NaN, no infinity."""
        return {
            "study": self.name,
            "settings": plain(self.settings),
            "figures": [
                {**plain(asdict(figure)), "floor": figure.floor, "reached": figure.reached} for figure in self.figures
            ],
            "tables": [plain(asdict(part)) for part in self.parts if isinstance(part, Table)],
        }

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write `study-NAME.html` and `study-NAME.json` into `folder`; returns both paths."""
        folder.mkdir(parents=True, exist_ok=True)
        page, data = folder / f"study-{self.name}.html", folder / f"study-{self.name}.json"
        page.write_text(self.page(), encoding="utf-8")
        data.write_text(json.dumps(self.document(), indent=2, allow_nan=False) + "\n", encoding="utf-8")
        return page, data

    def page(self) -> str:
        """The report as one self-contained HTML page."""
        bodies = [_figures_table(self.figures)]
        first = True
        for part in self.parts:
            if isinstance(part, Table):
                bodies.append(_html_table(part))
                continue
            title, figure = part
            figure.update_layout(template="plotly_white", margin={"l": 60, "r": 20, "t": 30, "b": 50}, height=420)
            plot = plotly.io.to_html(figure, full_html=False, include_plotlyjs=first, config={"displaylogo": False})
            bodies.append(f"<h2>{html.escape(title)}</h2>{plot}")
            first = False
        asked = ", ".join(f"{key} {_shown(value)}" for key, value in self.settings.items())
        paragraphs = "".join(f"<p>{html.escape(text)}</p>" for text in self.explanation.strip().split("\n\n"))
        return (
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(self.title)}</title>'
            f"<style>{STYLE}</style></head><body><main><h1>{html.escape(self.title)}</h1>"
            f'<p class="settings">{html.escape(asked)}</p>{paragraphs}{"".join(bodies)}'
            "<footer>Graspwatch: a research instrument, not a medical device.</footer></main></body></html>\n"
        )


STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1b1f24; margin: 0 }
main { max-width: 1100px; margin: 0 auto; padding: 1rem 1.5rem }
table { border-collapse: collapse; margin: 0.5rem 0 1.5rem; font-variant-numeric: tabular-nums }
th, td { padding: 0.25rem 0.8rem; border-bottom: 1px solid #d0d7de; text-align: right }
th:first-child, td:first-child { text-align: left }
td.words { text-align: left }
.missed { color: #a40000; font-weight: 600 }
.wide { overflow-x: auto }
.settings, footer { color: #57606a }
"""


def _figures_table(figures: list[Figure]) -> str:
    words = {True: "reached", False: '<span class="missed">not reached</span>', None: ""}
    rows = "".join(
        f"<tr><td>{html.escape(f.name)}</td><td>{_shown(f.value)} {html.escape(f.unit)}</td>"
        f"<td>{html.escape(f.floor)}</td><td>{words[f.reached]}</td>"
        f'<td class="words">{html.escape(f.note)}</td></tr>'
        for f in figures
    )
    head = "<tr><th>Figure</th><th>Measured</th><th>To reach</th><th></th><th></th></tr>"
    return f"<table>{head}{rows}</table>"


def _html_table(table: Table) -> str:
    head = "".join(f"<th>{html.escape(column)}</th>" for column in table.columns)
    rows = "".join(
        "<tr>" + "".join(f"<td>{html.escape(_shown(value))}</td>" for value in row) + "</tr>" for row in table.rows
    )
    return f"<h2>{html.escape(table.title)}</h2><div class='wide'><table><tr>{head}</tr>{rows}</table></div>"


def _shown(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.3g}" if math.isfinite(value) else "–"
    return str(value)


def plain(value: Any) -> Any:
    """Numpy numbers as Python's, what is not finite as None, whatever the nesting."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
