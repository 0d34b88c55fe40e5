"""Functions that render a self-contained HTML page for studies and reports: no network, printable on A4."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

NO_VALUE = "–"
# The page's style turns black marks on a plot white on a dark page.
MARK_COLOR = "#000000"
# The page contains its scripts, and a plot can be saved as a picture.
CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
TEMPLATES = Path(__file__).with_name("templates")


@dataclass(frozen=True, slots=True)
class Table:
    """A table of numbers and words; numbers have three significant digits."""

    title: str
    columns: list[str]
    rows: list[list[Any]]
    note: str = ""


def render_template(name: str, folder: Path = TEMPLATES, **context: Any) -> str:
    """Return a page rendered from a template of a folder, or of this package's; all texts but `Markup` are escaped.

    `kind` in the context names the page's generator, so that a later one knows whether it may overwrite the page.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # a slow import, which the server does not need

    environment = Environment(
        loader=FileSystemLoader([folder, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["value"] = _format_cell
    return environment.get_template(name).render(content_security_policy=CONTENT_SECURITY_POLICY, **context)


def _format_cell(value: Any) -> str:
    return value if isinstance(value, Markup) else format_value(value)


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
