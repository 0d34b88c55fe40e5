"""`make figures`: runs all studies, and renews the figures and plots of docs/estimation.md from what they found.

Needs Chromium. `--keep` takes the pages and JSONs that are in `studies/` already.
"""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

ROOT = Path(__file__).parents[1]
STUDIES, DOCS = ROOT / "studies", ROOT / "docs"
PAGE = DOCS / "estimation.md"
OPTIONS = {
    "limiter": ["--seed", "20261127"]  # one that nothing was tuned on
}
VARIANTS = {  # mark in the page: further options of `identify`
    "identify-no-touch": ["--no-touch"],
    "identify-5mv": ["--noise-mv", "5"],
    "identify-5mv-no-touch": ["--noise-mv", "5", "--no-touch"],
}
PLOTS = {  # picture: study, which of its plots
    "share-right": ("identify", 0),
    "reliability": ("identify", 1),
    "mismatch": ("mismatch", 0),
    "roc": ("unknown", 0),
    "initial": ("initial", 0),
    "paper-states": ("paper", 0),
    "limiter-peaks": ("limiter", 0),
    "limiter-course": ("limiter", 1),
}
TABLES = {  # mark in the page: study, which of its tables
    "parameters": ("identify", 1),
    "mismatch": ("mismatch", 0),
    "estimators": ("estimators", 0),
    "bounds": ("paper", 1),
    "limiter": ("limiter", 0),
    "beyond": ("limiter", 4),
}


def main() -> None:
    names = ["paper", "identify", "repeated", "unknown", "initial", "mismatch", "estimators", "limiter"]
    if "--keep" not in sys.argv:
        graspwatch = [Path(sys.executable).parent / "graspwatch", "study"]
        for name in names:
            subprocess.run([*graspwatch, name, "--out", STUDIES, *OPTIONS.get(name, ())], check=True, cwd=ROOT)
        for name, options in VARIANTS.items():
            words = ["identify", *options, "--out", STUDIES / name]
            subprocess.run([*graspwatch, *words], check=True, cwd=ROOT)
    found = {name: json.loads((STUDIES / f"study-{name}.json").read_text()) for name in names}
    found |= {name: json.loads((STUDIES / name / "study-identify.json").read_text()) for name in VARIANTS}
    text = PAGE.read_text()
    for name in found:
        text = between(text, name, figures_table(found[name]["figures"]))
    for mark, (study, which) in TABLES.items():
        text = between(text, f"table {mark}", plain_table(found[study]["tables"][which]))
    PAGE.write_text(text)
    draw()


def between(text: str, mark: str, content: str) -> str:
    """Put `content` between the page's marks of that name."""
    pattern = rf"(<!-- {mark} -->\n).*?(<!-- end -->)"
    renewed, count = re.subn(pattern, lambda found: found[1] + content + found[2], text, flags=re.DOTALL)
    if count != 1:
        raise SystemExit(f"{PAGE} needs one place marked '<!-- {mark} -->' … '<!-- end -->'; found {count}.")
    return renewed


def figures_table(figures: list[dict]) -> str:
    words = {True: "reached", False: "**not reached**", None: ""}
    rows = [
        f"| {f['name']} | {shown(f['value'])} {f['unit']} | {f['floor']} | {words[f['reached']]} |" for f in figures
    ]
    return "\n".join(["| figure | measured | to reach | |", "|---|---|---|---|", *rows, ""])


def plain_table(table: dict) -> str:
    head = ["| " + " | ".join(table["columns"]) + " |", "|---" * len(table["columns"]) + "|"]
    rows = ["| " + " | ".join(shown(value) for value in row) + " |" for row in table["rows"]]
    return "\n".join([*head, *rows, ""])


def shown(value: object) -> str:
    if value is None:
        return "–"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def draw() -> None:
    (DOCS / "figures").mkdir(exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 900, "height": 700})
        for picture, (study, which) in PLOTS.items():
            page.goto((STUDIES / f"study-{study}.html").as_uri())
            plot = page.locator(".plotly-graph-div").nth(which)
            plot.scroll_into_view_if_needed()
            plot.screenshot(path=DOCS / "figures" / f"{picture}.png")
        browser.close()


if __name__ == "__main__":
    main()
