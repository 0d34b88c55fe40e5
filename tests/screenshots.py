"""`make screenshots`: the dashboard while a simulated bladder is held, for the README."""

import shutil
import sys
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

sys.path.insert(1, str(Path(__file__).parent))

from service import Service

TARGET = Path(__file__).parents[1] / "docs" / "dashboard.png"

with Service("serve") as service, sync_playwright() as playwright:
    browser = playwright.chromium.launch(
        executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
    )
    page = browser.new_page(viewport={"width": 1920, "height": 1080}, color_scheme="dark")
    page.goto(service.url)
    run = service.run(protocol="trapezoid_2hz", cycles=3, tissue="gallbladder")
    service.finished(run["id"])
    service.run(protocol="trapezoid_2hz", cycles=3, tissue="bladder")
    time.sleep(3.6)
    page.screenshot(path=TARGET)
    browser.close()
print(f"wrote {TARGET}")
