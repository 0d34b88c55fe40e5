"""Draw public names and docstrings for readers who do not know the code: `python docs/readability.py SEED --names`.

The reader says what each means; somebody with the code at hand counts how many are right.
"""

import argparse
import ast
import random
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("acquisition", "app", "config", "estimator", "graspwatch")
COUNT = 20

Definition = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def find_public(node: ast.AST, path: str) -> Iterator[tuple[str, str | None]]:
    """Yield the qualified name and docstring of each public class and function in a module or class, and its own."""
    if isinstance(node, ast.Module):
        yield path, ast.get_docstring(node)
    for child in ast.iter_child_nodes(node):
        if isinstance(child, Definition) and not child.name.startswith("_"):
            name = f"{path}.{child.name}"
            yield name, ast.get_docstring(child)
            if isinstance(child, ast.ClassDef):
                yield from find_public(child, name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seed", type=int)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--names", action="store_true")
    what.add_argument("--docstrings", action="store_true")
    chosen = parser.parse_args()
    found = [
        each
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for each in find_public(ast.parse(path.read_text()), ".".join(path.relative_to(ROOT).with_suffix("").parts))
    ]
    if chosen.docstrings:
        found = [(name, text) for name, text in found if text]
    for number, (name, text) in enumerate(random.Random(chosen.seed).sample(found, COUNT), 1):
        print(f"{number}. {name if chosen.names else text}\n")


if __name__ == "__main__":
    main()
