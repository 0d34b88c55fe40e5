"""The live page in a real browser against the real service."""

import os
import signal

import pytest
from playwright.sync_api import expect
from proxy import Line
from service import Service
from watched import PAGES, SIZES

pytestmark = pytest.mark.browser


def test_from_start_to_label(service, watch):
    viewer = watch(service.url)
    viewer.start(cycles=2)
    expect(viewer.at("tissue-label")).to_have_text("Bladder")
    expect(viewer.at("grasps")).to_contain_text("Bladder")
    expect(viewer.at("tool-kind")).to_contain_text("SIMULATED")
    expect(viewer.at("criteria")).to_contain_text("ms")
    assert viewer.complaints == []
    assert all(url.startswith((service.url, service.live_url)) for url in viewer.requests)


def test_something_outside_the_library_is_unknown(service, watch):
    viewer = watch(service.url)
    viewer.start(protocol="trapezoid_2hz", tissue="fibrotic_liver")
    expect(viewer.at("tissue-label")).to_have_text("Unknown")


def test_two_viewers_see_the_same(service, watch):
    one, other = watch(service.url), watch(service.url)
    one.start(tissue="gallbladder", cycles=1)
    for viewer in (one, other):
        expect(viewer.at("tissue-label")).to_have_text("Gallbladder")
    for viewer in (one, other):
        expect(viewer.at("grasps")).to_contain_text("Gallbladder")
    assert one.at("grasps").inner_text() == other.at("grasps").inner_text()


@pytest.mark.parametrize("by", ["button", "key"])
@pytest.mark.parametrize("page", PAGES)
def test_stop_works_at_once_from_every_page(service, watch, page, by):
    one, other = watch(service.url), watch(service.url + PAGES[page])
    one.start(cycles=20)
    expect(other.page.locator("main h2").first).to_be_visible()
    if by == "button":
        other.at("stop").click()
    else:
        other.page.keyboard.press("Escape")
    expect(one.at("run-now")).to_contain_text("stopped", timeout=1_000)
    expect(other.at("stop-message")).to_contain_text("The motor is at zero", timeout=1_000)
    assert service.http.get("/api/runs").json()[-1]["state"] == "stopped"


def test_stop_by_key_works_while_a_list_or_a_dialog_is_open(service, watch):
    viewer = watch(service.url)
    viewer.start(cycles=20)
    viewer.at("protocol").click()
    viewer.page.keyboard.press("Escape")
    expect(viewer.at("run-now")).to_contain_text("stopped")
    viewer.start(cycles=20)
    viewer.page.keyboard.press("?")
    expect(viewer.page.get_by_role("dialog")).to_contain_text("STOP")
    viewer.page.keyboard.press("Escape")
    expect(viewer.at("run-now")).to_contain_text("stopped")


def test_a_refused_start_says_why(service, watch):
    viewer = watch(service.url)
    expect(viewer.at("protocol").locator("option")).not_to_have_count(0)
    service.run(protocol="trapezoid_025hz", cycles=20)
    viewer.at("start").click()
    expect(viewer.at("run-message")).to_contain_text("under way")


def test_who_started_holds_control_and_everybody_sees_it(service, watch):
    one, other = watch(service.url), watch(service.url)
    one.at("person").click()
    one.at("person-name").fill("Ada")
    one.page.keyboard.press("Enter")
    expect(one.at("person")).to_contain_text("Ada")
    one.start(cycles=20)
    expect(other.at("run-now")).to_contain_text("Control: Ada")


def test_by_keyboard_alone(service, watch):
    viewer = watch(service.url)
    expect(viewer.at("protocol").locator("option")).not_to_have_count(0)
    viewer.page.keyboard.press("?")
    keys = viewer.page.locator("#keys-list dt").all_text_contents()
    assert len({*keys}) == len(keys) > 20  # no key has two meanings
    viewer.page.keyboard.press("?")
    for _ in range(60):
        viewer.page.keyboard.press("Tab")
        if viewer.page.evaluate("document.activeElement.id") == "cycles":
            break
    viewer.page.keyboard.press("Control+a")
    viewer.page.keyboard.type("1")
    viewer.page.keyboard.press("Enter")
    expect(viewer.at("run-message")).to_contain_text("1 grasp")
    viewer.page.keyboard.press("Tab")
    viewer.page.keyboard.press("Tab")  # out of the fields, where a digit is only a digit
    viewer.page.keyboard.press("Shift+3")
    expect(viewer.at("tissues-table")).to_be_visible()
    viewer.page.keyboard.press("Shift+1")
    expect(viewer.at("tissue-label")).to_be_visible()
    viewer.page.keyboard.press("t")
    expect(viewer.page.locator("html")).to_have_attribute("data-theme", "light")
    viewer.page.keyboard.press("Escape")
    expect(viewer.at("stop-message")).to_contain_text("The motor is at zero")


def test_charts_pause_look_back_zoom_and_hide(service, watch):
    viewer = watch(service.url)
    charts = viewer.page.locator("#charts")
    expect(charts).to_have_attribute("data-empty", "false")
    viewer.page.wait_for_timeout(5_000)  # so that there is something to look back to
    plot = viewer.page.locator("#chart-force .u-over")
    box = plot.bounding_box()
    viewer.page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20)
    viewer.page.mouse.down()
    viewer.page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 20, steps=4)
    viewer.page.mouse.up()
    expect(charts).to_have_attribute("data-paused", "true")
    expect(viewer.page.locator("#scrub-text")).to_contain_text("3.0")  # 30 % of ten seconds
    before = viewer.at("scrub").input_value()
    viewer.page.keyboard.press("ArrowLeft")
    expect(viewer.at("scrub")).not_to_have_value(before)
    box = plot.bounding_box()
    viewer.page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20)
    for name in ("force", "displacement", "probability", "parameter"):
        expect(viewer.page.locator(f"#readout-{name}")).to_contain_text(" s:")
    viewer.at("zoom-reset").click()
    expect(charts).to_have_attribute("data-paused", "false")
    liver = viewer.page.get_by_role("group", name="Lines shown").get_by_role("button", name="Liver")
    liver.click()
    expect(liver).to_have_attribute("aria-pressed", "false")


@pytest.mark.alone
def test_a_frozen_service_is_shown_as_stale_by_the_pages_own_clock(watch):
    with Service("serve") as running:
        viewer = watch(running.url)
        expect(viewer.page.locator("#watch")).to_have_attribute("data-freshness", "live")
        os.kill(running.process.pid, signal.SIGSTOP)
        try:
            expect(viewer.at("stale-banner")).to_be_visible(timeout=1_600)
            expect(viewer.at("stale-banner")).to_contain_text("No data since")
            expect(viewer.at("alarm-text")).to_contain_text("No data")
        finally:
            os.kill(running.process.pid, signal.SIGCONT)
        expect(viewer.at("stale-banner")).to_be_hidden()


@pytest.mark.alone
@pytest.mark.parametrize("page", ["live", "tissues"])
def test_a_cut_connection_is_told_within_a_second_and_afterwards_how_long_it_was_blind(service, watch, page):
    with Line(service.port) as line:
        viewer = watch(line.url + PAGES[page])
        expect(viewer.page.locator("#status-rate")).to_contain_text("Hz")
        viewer.page.evaluate("""() => {
            const banner = document.getElementById("stale-banner");
            new MutationObserver(() => { if (!banner.hidden) window.toldAt ??= Date.now(); })
                .observe(banner, { attributes: true });
        }""")
        viewer.page.wait_for_timeout(500)
        cut_ms = viewer.page.evaluate("Date.now()")
        line.cut()
        expect(viewer.at("stale-banner")).to_contain_text("No connection")
        assert viewer.page.evaluate("window.toldAt") - cut_ms < 1_250  # data count as lost from 1 s on
        expect(viewer.at("alarm-text")).to_contain_text("No connection")
        line.mend()
        expect(viewer.at("notice")).to_contain_text("saw nothing for")
        expect(viewer.at("stale-banner")).to_be_hidden()
        expect(viewer.at("alarm-text")).to_have_text("No alarms")


def test_a_stop_that_cannot_be_sent_says_so_and_stays(service, watch):
    with Line(service.port) as line:
        viewer = watch(line.url)
        expect(viewer.page.locator("#status-rate")).to_contain_text("Hz")
        line.cut()
        viewer.page.keyboard.press("Escape")
        expect(viewer.at("stop-message")).to_contain_text("use the hardware switch")
        expect(viewer.at("alarm-bar")).to_have_attribute("data-priority", "high")
        line.mend()
        viewer.page.keyboard.press("Escape")
        expect(viewer.at("stop-message")).to_contain_text("The motor is at zero")


def test_a_stop_that_a_hanging_server_did_not_take_ends_by_itself_once_the_tool_stands_still(watch):
    with Service("serve") as running:
        viewer = watch(running.url)
        expect(viewer.page.locator("#watch")).to_have_attribute("data-freshness", "live")
        running.run(protocol="trapezoid_025hz", cycles=20, tissue="bladder")
        os.kill(running.process.pid, signal.SIGSTOP)
        try:
            viewer.page.keyboard.press("Escape")
            expect(viewer.at("stop-message")).to_contain_text("use the hardware switch", timeout=8_000)
            expect(viewer.at("alarm-bar")).to_have_attribute("data-priority", "high")
        finally:
            os.kill(running.process.pid, signal.SIGCONT)
        expect(viewer.at("stop-message")).to_contain_text("The motor is at zero", timeout=10_000)
        expect(viewer.at("alarm-bar")).not_to_contain_text("STOP not sent")


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_what_counts_is_in_sight_on_every_screen(service, watch, width, height):
    viewer = watch(service.url, width=width, height=height)
    expect(viewer.at("tissue-label")).to_be_visible()
    for name in ("tissue-label", "alarm-bar", "stop"):
        box = viewer.at(name).bounding_box()
        assert 0 <= box["y"] <= height - box["height"], name
    assert viewer.at("stop").bounding_box()["height"] >= 44
    if width >= 1100:
        footer = viewer.page.locator("footer").bounding_box()
        for name in ("force-now", "gauge", "force-threshold"):
            box = viewer.page.locator(f"#{name}").bounding_box()
            assert box["y"] + box["height"] <= footer["y"], name


def test_escape_closes_a_dialog_and_sends_no_stop_while_the_tool_stands_still(service, watch):
    viewer = watch(service.url)
    expect(viewer.page.locator("#watch")).to_have_attribute("data-freshness", "live")
    viewer.page.keyboard.press("?")
    keys = viewer.page.locator("#keys")
    expect(keys.get_by_role("heading", name="Keys")).to_be_in_viewport()
    viewer.page.keyboard.press("Escape")
    expect(keys).to_be_hidden()
    viewer.page.keyboard.press("Escape")
    expect(viewer.at("stop-message")).to_contain_text("nothing was running")
    assert sum(request.endswith("/api/stop") for request in viewer.requests) == 1


def test_the_forces_of_the_filters_have_a_chart_of_their_own(service, watch):
    viewer = watch(service.url)
    expect(viewer.page.locator("#lines-force")).not_to_contain_text("Liver")
    viewer.page.keyboard.press("g")
    expect(viewer.page.locator("#parameter-unit")).to_have_text("N, force by each filter")
    expect(viewer.page.locator("#lines-parameter")).to_contain_text("filtered")
