"""`make screenshots`: take pictures of the dashboard in each state into docs/screenshots/, for a look afterwards."""

import json
import os
import re
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright
from rich.progress import track

sys.path.insert(1, str(Path(__file__).parent))

from proxy import Line
from service import Service
from simulation import joined, simulate_raw, write_lvm

from config.load import CONFIG_DIR

TARGET = Path(__file__).parents[1] / "docs" / "screenshots"
WALL, TABLET, UPRIGHT, PHONE = (1920, 1080), (1280, 800), (800, 1280), (390, 844)
AREAS = [
    "tissue",
    "force",
    "charts",
    "protocol",
    "stress",
    "grasps",
    "recordings",
    "library",
    "library-plot",
    "studies",
    "study-form",
    "calibration",
    "configuration",
    "journal",
]
IN_CONTACT = "(document.querySelector('#tissue[data-past=false] .answer-facts')?.textContent ?? '')"


class Studio:
    """Pictures of one service's dashboard."""

    def __init__(self, browser: Browser, service: Service) -> None:
        self._browser, self._service = browser, service

    @contextmanager
    def page(
        self,
        size: tuple[int, int] = WALL,
        path: str = "/",
        theme: str = "dark",
        *,
        explained: bool = True,
        url: str | None = None,
    ) -> Iterator[Page]:
        """Open a page; with `explained` its first-visit explanations count as read."""
        viewport = {"width": size[0], "height": size[1]}
        # waiting for a state evaluates a text, which the page's policy forbids
        context = self._browser.new_context(viewport=viewport, color_scheme=theme, bypass_csp=True)
        page = context.new_page()
        if explained:
            page.add_init_script(f"""
                localStorage.setItem("graspwatch-hints-seen", {json.dumps(json.dumps(AREAS))});
                localStorage.setItem("graspwatch-person", "Ada");
            """)
        page.goto((url or self._service.url) + path)
        page.wait_for_function("document.getElementById('status-rate').textContent.includes('Hz')")
        yield page
        context.close()

    def run(self, tissue: str, protocol: str = "trapezoid_025hz", cycles: int = 2) -> None:
        self._service.http.post("/api/stop")
        self._service.run(protocol=protocol, cycles=cycles, tissue=tissue, by="Ada")

    def named(self, name: str, size: tuple[int, int], theme: str, tissue: str = "bladder") -> None:
        with self.page(size, theme=theme) as page:
            self.run("gallbladder", "trapezoid_4hz", 3)
            page.wait_for_function("document.querySelectorAll('#grasps-body tr').length === 3")
            self.run(tissue)
            page.wait_for_function(f"/decided/.test({IN_CONTACT})")
            page.wait_for_timeout(900)
            shoot(page, name)

    def unknown(self) -> None:
        with self.page() as page:
            self.run("fibrotic_liver")
            page.wait_for_function(f"/nothing of the library/.test({IN_CONTACT})")
            page.wait_for_timeout(600)
            shoot(page, "unknown")

    def undecided(self) -> None:
        """Take a picture of an undecided grasp. Liver and small bowel overlap, so some specimen stays undecided."""
        with self.page() as page:
            self.run("small_bowel", cycles=20)
            undecided = f"/likeliest/.test({IN_CONTACT})"
            while True:
                page.wait_for_function(undecided, timeout=60_000)
                page.wait_for_timeout(400)
                shoot(page, "undecided")
                if page.evaluate(undecided):  # still undecided after the picture
                    return

    def warning(self) -> None:
        with self.page() as page:
            self.run("bladder", "strong_2hz", 3)
            page.wait_for_selector("#force-holding:not([hidden])")
            shoot(page, "warning")

    def empty(self) -> None:
        with self.page(explained=False) as page:
            page.wait_for_timeout(1_500)
            shoot(page, "empty")

    def disconnected(self) -> None:
        with Line(self._service.port) as line, self.page(url=line.url) as page:
            self.run("gallbladder")
            page.wait_for_function(f"/decided/.test({IN_CONTACT})")
            line.cut()
            page.wait_for_timeout(3_000)
            shoot(page, "disconnected")

    def stale(self) -> None:
        with self.page() as page:
            self.run("gallbladder")
            page.wait_for_function(f"/decided/.test({IN_CONTACT})")
            acquisition = self._service.worker("acquisition")
            os.kill(acquisition, signal.SIGSTOP)
            page.wait_for_selector("#stale-banner:not([hidden])")
            shoot(page, "stale")
            os.kill(acquisition, signal.SIGCONT)

    def replay(self) -> None:
        with self.page(path="/recordings/gallbladder.lvm") as page:
            page.wait_for_selector("#replay-play:enabled", timeout=60_000)
            page.wait_for_function(f"/decided/.test({IN_CONTACT})")
            page.keyboard.press(" ")
            page.wait_for_timeout(300)
            shoot(page, "replay")

    def other_page(self, name: str) -> None:
        with self.page(path=f"/{name}") as page:
            page.wait_for_timeout(2_000)
            shoot(page, name)


def shoot(page: Page, name: str) -> None:
    page.screenshot(path=TARGET / f"{name}.png")


def alarm(browser: Browser) -> None:
    """Take a picture of a high force alarm; in this service it begins below the limiter's 80 % of the threshold."""
    text = (CONFIG_DIR / "graspwatch.toml").read_text()
    for level, share in {"low": 0.5, "medium": 0.65, "high": 0.75}.items():
        text = re.sub(rf"(?m)^{level} = [0-9.]+", f"{level} = {share}", text)
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as config:
        config.write(text)
        config.flush()
        with Service("serve", "--config", config.name) as service:
            studio = Studio(browser, service)
            with studio.page() as page:
                studio.run("bladder", "strong_2hz", 5)
                page.wait_for_selector("#alarm-bar[data-priority=high]")
                page.wait_for_timeout(150)
                shoot(page, "alarm")


def main() -> None:
    TARGET.mkdir(exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        with Service("serve") as service:
            for tissue in ("gallbladder", "bladder"):
                path = service.data / "recordings" / f"{tissue}.lvm"
                write_lvm(path, joined(simulate_raw(tissue, "trapezoid_2hz", cycles=4)))
            studio = Studio(browser, service)
            pictures: list[Callable[[], None]] = [
                studio.empty,
                lambda: studio.named("alive", WALL, "dark"),
                lambda: studio.named("light", WALL, "light"),
                lambda: studio.named("tablet", TABLET, "dark"),
                lambda: studio.named("tablet-upright", UPRIGHT, "dark"),
                lambda: studio.named("phone", PHONE, "dark"),
                studio.undecided,
                studio.unknown,
                studio.warning,
                studio.replay,
                *(lambda name=name: studio.other_page(name) for name in ("recordings", "tissues", "studies", "system")),
                studio.disconnected,
                studio.stale,
                lambda: alarm(browser),
            ]
            for take in track(pictures, "Taking pictures"):
                take()
        browser.close()
    print(f"wrote {len(pictures)} pictures to {TARGET}")


main()
