"""What people read names no address of a request: it means nothing to an operator."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

APP = Path(__file__).parents[2] / "app"
REQUEST = re.compile(r"\b(GET|HEAD|POST|PUT|PATCH|DELETE) /|/api/")
HTML = Path(__file__).parents[2] / "frontend"


def texts_of_errors(tree: ast.AST) -> Iterator[str]:
    """Yield the texts of all errors that are raised, and of constants that end in `_TEXT`."""
    for node in ast.walk(tree):
        named = isinstance(node, ast.Assign) and any(
            isinstance(target, ast.Name) and target.id.lower().endswith(("text", "detail")) for target in node.targets
        )
        if named or isinstance(node, ast.Raise):
            for part in ast.walk(node):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield part.value


@pytest.mark.parametrize("file", sorted(APP.rglob("*.py")), ids=lambda file: str(file.relative_to(APP)))
def test_an_error_names_no_request(file: Path) -> None:
    texts = list(texts_of_errors(ast.parse(file.read_text(encoding="utf-8"))))
    assert [text for text in texts if REQUEST.search(text)] == []


@pytest.mark.parametrize("page", sorted(HTML.glob("*.html")) + sorted(HTML.glob("src/**/*.html")), ids=lambda f: f.name)
def test_a_page_shows_no_request(page: Path) -> None:
    shown = re.sub(r"<[^>]*>", " ", page.read_text(encoding="utf-8"))
    assert REQUEST.search(shown) is None
