"""A self-contained HTML page for studies and reports: no network, light and dark, printable on A4."""

import html
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

NO_VALUE = "–"
# STYLE turns black marks on a plot white on a dark page.
MARK_COLOR = "#000000"
# The page contains its scripts, and a plot can be saved as a picture.
CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)


@dataclass(frozen=True, slots=True)
class Table:
    """A table of numbers and words; numbers have three significant digits."""

    title: str
    columns: list[str]
    rows: list[list[Any]]
    note: str = ""


@dataclass(frozen=True, slots=True)
class TrustedHtml:
    """Trusted HTML for a cell of a table."""

    text: str

    def __str__(self) -> str:
        return self.text


TEXT_TYPES, TEXT_CLASS_ATTRIBUTE = (str, TrustedHtml), ' class="words"'

STYLE = """
:root { color-scheme: light dark; --page: #ffffff; --text: #1b1f24; --dim: #57606a; --edge: #d0d7de; --grid: #e4e8ec;
  --raised: #eef1f4; --bad: #a40000; --link: #00507f; --ink: #000000 }
@media screen and (prefers-color-scheme: dark) { :root { --page: #0f1419; --text: #e8edf1; --dim: #aab6c0;
  --edge: #3a4650; --grid: #2a343d; --raised: #1c252d; --bad: #ff9a9a; --link: #9fd0f5; --ink: #ffffff } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--text); background: var(--page); margin: 0 }
main { max-width: 1100px; margin: 0 auto; padding: 1rem 1.5rem }
a { color: var(--link) }
h2 { margin: 2rem 0 0.5rem; line-height: 1.25 }
table { border-collapse: collapse; margin: 0.5rem 0 1.5rem; font-variant-numeric: tabular-nums }
caption { text-align: left; color: var(--dim); padding-bottom: 0.25rem }
th, td { padding: 0.25rem 0.8rem; border-bottom: 1px solid var(--edge); text-align: right }
th { font-weight: 600 }
th:first-child, td:first-child, .words { text-align: left }
.missed { color: var(--bad); font-weight: 600 }
.wide { overflow-x: auto }
.wide:focus-visible, a:focus-visible, button:focus-visible { outline: 3px solid var(--ink); outline-offset: 2px }
.settings, .note, footer { color: var(--dim) }
.plotly-graph-div .main-svg { background: transparent !important }
.plotly-graph-div .bg { fill: transparent !important }
.plotly-graph-div :is(.xaxislayer-above, .yaxislayer-above, .infolayer) text { fill: var(--text) !important }
.plotly-graph-div .gridlayer path { stroke: var(--grid) !important }
.plotly-graph-div :is(.zerolinelayer, .xlines-above, .ylines-above) path { stroke: var(--edge) !important }
.plotly-graph-div [style*="stroke: rgb(0, 0, 0)"] { stroke: var(--ink) !important }
.plotly-graph-div :is(.points, .legendpoints) [style*="fill: rgb(0, 0, 0)"] { fill: var(--ink) !important }
@page { size: A4; margin: 14mm 13mm }
@media print {
  body { font-size: 10pt } main { max-width: none; padding: 0 }
  h2, h3, caption { break-after: avoid } tr, .plotly-graph-div, figure { break-inside: avoid }
  thead { display: table-header-group } .wide { overflow: visible } table { font-size: 8pt }
  th, td { padding: 0.1rem 0.35rem } .plotly-graph-div { zoom: 0.62 }
  .modebar, .screen-only { display: none !important }
}
"""


def render_page(title: str, body: str, style: str = "", *, kind: str) -> str:
    """Return the whole page; `kind` names its generator, so that a later one knows whether it may overwrite it."""
    name = html.escape(title)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="generator" content="{kind}">'
        f'<meta http-equiv="Content-Security-Policy" content="{html.escape(CONTENT_SECURITY_POLICY)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{name}</title>'
        f"<style>{STYLE}{style}</style></head><body><main><h1>{name}</h1>{body}"
        "<footer>Graspwatch: a research instrument, not a medical device.</footer></main></body></html>\n"
    )


def render_paragraphs(text: str) -> str:
    """Render text as HTML; an empty line begins a paragraph."""
    return "".join(f"<p>{html.escape(part)}</p>" for part in text.strip().split("\n\n"))


def render_table(content: Table, *, heading: bool = True, level: int = 2) -> str:
    """Render a table as HTML, in a box that scrolls if it is too wide. Its title is a heading or a caption."""
    name = html.escape(content.title)
    head = render_headings(content.columns, content.rows)
    above = f"<h{level}>{name}</h{level}>" if heading else ""
    caption = "" if heading else f"<caption>{name}</caption>"
    note = f'<p class="note">{html.escape(content.note)}</p>' if content.note else ""
    return (
        f'{above}<div class="wide" tabindex="0" role="group" aria-label="{name}"><table>{caption}<thead><tr>{head}'
        f"</tr></thead><tbody>{render_rows(content.rows)}</tbody></table></div>{note}"
    )


def render_headings(columns: list[str], content: list[list[Any]]) -> str:
    """Render a table's header row as HTML; headers over words are left-aligned."""
    first = [next((row[k] for row in content if row[k] is not None), None) for k in range(len(columns))]
    return "".join(
        f'<th scope="col"{TEXT_CLASS_ATTRIBUTE if isinstance(value, TEXT_TYPES) else ""}>{html.escape(column)}</th>'
        for column, value in zip(columns, first, strict=True)
    )


def render_rows(content: Iterable[list[Any]]) -> str:
    """Render rows as HTML; the first cell is the row's heading."""
    return "".join(
        f'<tr><th scope="row">{render_cell(first)}</th>' + "".join(_render_data_cell(value) for value in rest) + "</tr>"
        for first, *rest in content
    )


def _render_data_cell(value: Any) -> str:
    return f"<td{TEXT_CLASS_ATTRIBUTE if isinstance(value, TEXT_TYPES) else ''}>{render_cell(value)}</td>"


def render_cell(value: Any) -> str:
    """Render a cell's content as HTML."""
    return value.text if isinstance(value, TrustedHtml) else html.escape(format_value(value))


def format_value(value: Any) -> str:
    """Format a value with three significant digits, or all before the point; a dash for no value."""
    if value is None:
        return NO_VALUE
    if isinstance(value, float):
        if not math.isfinite(value):
            return NO_VALUE
        return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"
    return str(value)


def to_json_value(value: Any) -> Any:
    """Convert numpy numbers to Python's and values that are not finite to None, also in nested containers."""
    if isinstance(value, dict):
        return {str(key): to_json_value(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_json_value(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
