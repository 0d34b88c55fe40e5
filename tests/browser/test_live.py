"""The dashboard in a real browser against the real service."""

import os
import signal

import pytest
from playwright.sync_api import expect
from service import Service
from simulation import joined, simulate_raw, write_lvm

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def running_service():
    with Service("serve") as running:
        yield running


@pytest.fixture
def service(running_service):
    yield running_service
    running_service.http.post("/api/stop")


def start(watched, protocol="trapezoid_025hz", cycles=3, tissue="bladder"):
    watched.at("protocol").select_option(protocol)
    watched.at("cycles").fill(str(cycles))
    watched.at("tissue-select").select_option(tissue)
    watched.at("start").click()
    expect(watched.at("run-message")).to_contain_text("Started", timeout=5_000)


def test_from_start_to_label(service, watch):
    viewer = watch(service.url)
    start(viewer, cycles=2)
    expect(viewer.at("tissue-label")).to_contain_text("Bladder", ignore_case=True, timeout=10_000)
    expect(viewer.at("grasps")).to_contain_text("Bladder", ignore_case=True, timeout=10_000)
    expect(viewer.at("tool-kind")).to_contain_text("simulated", ignore_case=True)
    assert viewer.complaints == []
    assert all(url.startswith((service.url, service.live_url)) for url in viewer.requests)


def test_two_viewers_see_the_same(service, watch):
    one, other = watch(service.url), watch(service.url)
    start(one, tissue="gallbladder")
    for viewer in (one, other):
        expect(viewer.at("tissue-label")).to_contain_text("Gallbladder", ignore_case=True, timeout=10_000)


@pytest.mark.parametrize("by", ["button", "key"])
def test_stop_works_at_once_on_all_pages(service, watch, by):
    one, other = watch(service.url), watch(service.url)
    start(one, cycles=20)
    expect(other.page.locator("#run-now")).to_contain_text("Running", timeout=5_000)
    if by == "button":
        other.at("stop").click()
    else:
        other.page.keyboard.press("Escape")
    for viewer in (one, other):
        expect(viewer.page.locator("#run-now")).to_contain_text("stopped", timeout=1_000)
    assert service.http.get("/api/runs").json()[-1]["state"] == "stopped"


def test_a_refused_start_says_why(service, watch):
    viewer = watch(service.url)
    expect(viewer.at("protocol").locator("option")).not_to_have_count(0)  # the page has learned what there is
    service.run(protocol="trapezoid_025hz", cycles=20)
    viewer.at("start").evaluate("button => { button.disabled = false; button.click(); }")
    expect(viewer.at("run-message")).to_contain_text("under way", timeout=3_000)


def test_a_frozen_service_is_shown_as_stale_by_the_pages_own_clock(watch):
    with Service("serve") as running:
        viewer = watch(running.url)
        expect(viewer.at("stale-banner")).to_be_hidden(timeout=5_000)
        os.kill(running.process.pid, signal.SIGSTOP)
        try:
            expect(viewer.at("stale-banner")).to_be_visible(timeout=1_600)
            expect(viewer.at("stale-banner")).to_contain_text("no data", ignore_case=True)
        finally:
            os.kill(running.process.pid, signal.SIGCONT)
        expect(viewer.at("stale-banner")).to_be_hidden(timeout=5_000)


def test_a_recording_is_marked_as_replay(watch, tmp_path):
    path = write_lvm(tmp_path / "grasp.lvm", joined(simulate_raw("gallbladder", "trapezoid_025hz", cycles=4)))
    with Service("replay", str(path), "--serve") as running:
        viewer = watch(running.url)
        expect(viewer.at("tool-kind")).to_contain_text("replay", ignore_case=True, timeout=5_000)
        expect(viewer.at("grasps")).to_contain_text("%", timeout=15_000)


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (1280, 800), (800, 1280), (390, 844)])
def test_fits_every_screen(service, watch, width, height):
    viewer = watch(service.url, width=width, height=height)
    expect(viewer.at("tissue-label")).to_be_visible(timeout=5_000)
    overflow = viewer.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert overflow <= 0
    box = viewer.at("stop").bounding_box()
    assert box["height"] >= 44
    assert 0 <= box["y"] <= height - box["height"]
