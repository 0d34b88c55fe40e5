import os
import shutil

import pytest
from people import config_with
from playwright.sync_api import expect, sync_playwright
from service import Service
from watched import Watched

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-sync"]

expect.set_options(timeout=30_000)  # a test that judges how long something takes gives its own


@pytest.fixture(scope="session")
def browser():
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if not program:
        reason = "no Chromium on this machine (Debian: apt install chromium)"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=program, args=FLAGS)
        yield running
        running.close()


@pytest.fixture
def watch(browser):
    opened = []

    def open_page(url, **options):
        opened.append(Watched(browser, url, **options))
        return opened[-1]

    yield open_page
    for watched in opened:
        watched.context.close()


@pytest.fixture(scope="session")
def calm(tmp_path_factory):
    """Settings with ten frames a second: without a GPU a page with thirty takes most of a core, and others wait."""
    return ("--config", str(config_with(tmp_path_factory.mktemp("calm"), frame_rate_hz=10.0)))


@pytest.fixture(scope="module")
def running_service(calm):
    with Service("serve", *calm) as running:
        yield running


@pytest.fixture
def service(running_service):
    yield running_service
    running_service.http.post("/api/stop")
