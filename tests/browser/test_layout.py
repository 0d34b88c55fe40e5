"""Nothing on the live page moves, in either view; the OR view fills every screen without a scroll bar."""

import os
import signal

import pytest
from people import bearer, give_tokens
from playwright.sync_api import expect
from service import Service

from app.messages.people import Role

pytestmark = pytest.mark.browser

SIZES = [(390, 844), (844, 390), (800, 1280), (1280, 800), (1366, 768), (1600, 900), (1920, 1080), (3840, 2160)]
ZOOMED_SIZES = [(853, 533), (1280, 720)]  # 1280 x 800 and 1920 x 1080 at 150 %
MOST_SHIFT = 0.005  # rounds to 0.00
CAP_HEIGHT = 0.7  # of the font size; Arial has 0.716, DejaVu Sans 0.729
OBSERVE_SHIFTS = """
    window.shifts = [];
    new PerformanceObserver((list) => {
        for (const entry of list.getEntries()) {
            if (entry.hadRecentInput) continue;
            const names = entry.sources.map(({ node }) => node?.id || node?.parentElement?.id || "?");
            window.shifts.push({ value: entry.value, names: names.join(" ") });
        }
    }).observe({ type: "layout-shift", buffered: true });
"""


def shift_of(page):
    return page.evaluate("window.shifts.reduce((sum, { value }) => sum + value, 0)")


@pytest.mark.alone  # four pages at once, beside which a run must not be late
@pytest.mark.parametrize("view", ["or", "detailed"])
def test_nothing_moves_from_the_first_paint_through_alarms_stop_and_lost_data(service, browser, view):
    contexts = [browser.new_context(viewport={"width": width, "height": height}) for width, height in SIZES[:7:2]]
    pages = [context.new_page() for context in contexts]
    for page in pages:
        page.add_init_script(OBSERVE_SHIFTS)
        page.goto(f"{service.url}/?view={view}")
    try:
        service.run(protocol="strong_2hz", cycles=40, tissue="bladder")
        for page in pages:
            expect(page.locator("#force-holding")).to_be_visible()
            expect(page.locator("#alarm-bar")).not_to_have_attribute("data-priority", "none")
        service.http.post("/api/stop")
        service.run(protocol="trapezoid_2hz", cycles=20, tissue="small_bowel")
        acquisition = service.worker("acquisition")
        os.kill(acquisition, signal.SIGSTOP)
        try:
            for page in pages:
                expect(page.locator("#stale-banner")).to_be_visible()
        finally:
            os.kill(acquisition, signal.SIGCONT)
        for page in pages:
            expect(page.locator("#stale-banner")).to_be_hidden()
        service.acknowledge_fault()
        for page in pages:
            page.route("**/api/stop", lambda route: route.abort())
            page.keyboard.press("Escape")
            expect(page.locator("#stop-message")).to_contain_text("could not be sent")
        for page in pages:
            expect(page.locator("#tissue")).to_have_attribute("data-past", "true")
            assert shift_of(page) < MOST_SHIFT, (page.viewport_size, page.evaluate("window.shifts"))
    finally:
        for context in contexts:
            context.close()


@pytest.fixture(scope="module")
def or_view(running_service, browser):
    """A page in the OR view during a grasp of the longest name of the library."""
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"{running_service.url}/?view=or")
    running_service.run(protocol="trapezoid_025hz", cycles=50, tissue="gallbladder")
    expect(page.locator("#tissue-label")).to_have_text("Gallbladder")
    yield page
    running_service.http.post("/api/stop")
    context.close()


@pytest.mark.parametrize(("width", "height"), SIZES + ZOOMED_SIZES)
def test_the_or_view_fills_every_screen_without_a_scroll_bar(or_view, width, height):
    or_view.set_viewport_size({"width": width, "height": height})
    root = "document.documentElement"
    for axis in ("Width", "Height"):
        assert or_view.evaluate(f"{root}.scroll{axis} - {root}.client{axis}") == 0
    for name in (
        "tissue-label",
        "tissue-probability",
        "tissue-spot",
        "force-now",
        "gauge",
        "force-limit",
        "alarm-bar",
        "stop",
        "view",
    ):
        box = or_view.locator(f"#{name}").bounding_box()
        assert 0 <= box["x"] <= width - box["width"], name
        assert 0 <= box["y"] <= height - box["height"], name
    for name in ("tissue", "force"):
        card = or_view.locator(f"#{name}")
        assert card.evaluate(
            "card => [card.scrollWidth - card.clientWidth, card.scrollHeight - card.clientHeight]"
        ) == [0, 0]
    expect(or_view.locator("#charts")).to_be_hidden()
    if width >= 1600:
        font_px = or_view.locator("#tissue-label").evaluate("label => parseFloat(getComputedStyle(label).fontSize)")
        assert font_px * CAP_HEIGHT >= height / 12


def test_a_key_changes_the_view_and_the_browser_keeps_it(service, watch):
    viewer = watch(service.url)
    expect(viewer.page.locator("#charts")).to_be_visible()
    viewer.page.keyboard.press("v")
    expect(viewer.page.locator("#charts")).to_be_hidden()
    viewer.page.reload()
    expect(viewer.at("force-now")).to_be_visible()
    expect(viewer.page.locator("#charts")).to_be_hidden()
    viewer.page.keyboard.press("Shift+2")
    expect(viewer.page.get_by_role("link", name="Live")).to_be_visible()  # the other pages have their navigation
    viewer.page.keyboard.press("Shift+1")
    viewer.at("view").click()
    expect(viewer.page.locator("#charts")).to_be_visible()


def test_a_viewer_finds_the_or_view_and_an_operator_all_details(calm, watch, tmp_path):
    (tmp_path / "recordings").mkdir()
    tokens = give_tokens(tmp_path)
    with Service("serve", *calm, "--host", "0.0.0.0", data=tmp_path) as service:
        for role, shows_charts in ((Role.VIEWER, False), (Role.OPERATOR, True)):
            viewer = watch(service.url)
            viewer.at("sign-in-token").fill(tokens[role])
            viewer.at("sign-in-send").click()
            expect(viewer.at("force-now")).to_be_visible()
            expect(viewer.page.locator("#charts")).to_be_visible(visible=shows_charts)
            viewer.page.add_init_script(OBSERVE_SHIFTS)
            viewer.page.reload()
            expect(viewer.at("force-limit")).to_contain_text("Limit")
            assert shift_of(viewer.page) < MOST_SHIFT, viewer.page.evaluate("window.shifts")
        service.http.post("/api/stop", headers=bearer(tokens[Role.ADMIN]))
