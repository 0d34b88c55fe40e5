"""The documentation as a site, and its links, also those to files of the checkout."""

import re
import subprocess
import sys
from pathlib import Path

CHECKOUT = Path(__file__).parents[2]
PAGES = [*CHECKOUT.glob("*.md"), *CHECKOUT.glob("docs/**/*.md")]


def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    command = [Path(sys.executable).with_name("mkdocs"), "build", "--strict", "--site-dir", tmp_path]
    built = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    page = (tmp_path / "reference/client.html").read_text()
    for method in ("start", "stop", "running", "live", "messages", "grasps"):
        assert f"graspwatch.Graspwatch.{method}" in page, method
    outside = re.findall(r'(?:src|href)="(https?://[^"]+)"', (tmp_path / "index.html").read_text())
    assert [each for each in outside if "squidfunk" not in each] == []


def test_every_link_leads_somewhere() -> None:
    lost = []
    for page in PAGES:
        text = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            path, _, _ = target.partition("#")
            if path and "://" not in path and not (page.parent / path).exists():
                lost.append(f"{page.relative_to(CHECKOUT)}: {target}")
    assert lost == []
