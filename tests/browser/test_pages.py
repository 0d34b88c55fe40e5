"""All pages: fit every screen, meet axe's rules in both themes, come from this server alone."""

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect
from service import Service
from simulation import joined, simulate_raw, simulated_recording_tool, write_lvm
from watched import PAGES, SIZES

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def running_service(calm):
    with Service("serve", *calm) as running:
        grasps = joined(simulate_raw("gallbladder", cycles=3, tool=simulated_recording_tool()))
        write_lvm(running.data / "recordings" / "gallbladder.lvm", grasps)
        (running.data / "recordings" / "broken.lvm").write_text("LabVIEW Measurement\n")
        running.finished(running.run(protocol="trapezoid_4hz", cycles=2, tissue="liver")["id"])
        yield running


EVERY_PAGE = {
    **PAGES,
    "replay": "/recordings/gallbladder.lvm",
    "calibration": "/calibration",
    "configuration": "/configuration",
}


def opened(watch, service, page, **options):
    """The page once it has its data."""
    viewer = watch(service.url + EVERY_PAGE[page], **options)
    expect(viewer.page.locator("main h2").first).to_be_visible()
    if page == "replay":
        expect(viewer.at("replay-play")).to_be_enabled()
    viewer.page.wait_for_timeout(700)
    return viewer


def axe_complaints(viewer):
    results = Axe().run(viewer.page)
    return results.generate_report() if results.violations_count else ""


@pytest.mark.parametrize("page", EVERY_PAGE)
def test_a_page_fits_every_screen_and_a_gloved_hand_and_meets_axes_rules(service, watch, page):
    viewer = opened(watch, service, page)
    assert axe_complaints(viewer) == ""
    small = viewer.page.evaluate("""() =>
        [...document.querySelectorAll("button, select, input, textarea, summary, nav a")]
        .filter((each) => each.checkVisibility() && !each.closest(".lines"))
        .map((each) => [each.id || each.textContent, each.getBoundingClientRect()])
        .filter(([, box]) => box.height < 43.5 || box.width < 43.5)
        .map(([name, box]) => `${name}: ${box.width} x ${box.height}`)""")
    assert small == []
    for width, height in SIZES:
        viewer.page.set_viewport_size({"width": width, "height": height})
        viewer.page.wait_for_timeout(300)
        assert viewer.overflow() <= 0, (width, height)


@pytest.mark.parametrize("page", EVERY_PAGE)
def test_a_light_page_meets_axes_rules(service, watch, page):
    assert axe_complaints(opened(watch, service, page, theme="light")) == ""


def test_nothing_comes_from_elsewhere_and_nothing_is_complained_about(service, watch):
    viewer = watch(service.url)
    for name in PAGES:
        viewer.page.locator(f"nav [data-page={name}]").click()
        expect(viewer.page.locator(f"nav [data-page={name}]")).to_have_attribute("aria-current", "page")
        expect(viewer.page.locator("main h2").first).to_be_visible()
        viewer.page.wait_for_timeout(300)
    viewer.page.goto(service.url + EVERY_PAGE["replay"])
    expect(viewer.at("replay-play")).to_be_enabled()
    assert viewer.complaints == []
    assert all(url.startswith((service.url, service.url.replace("http", "ws"))) for url in viewer.requests)


def test_the_first_visit_explains_the_page_once(service, watch):
    viewer = watch(service.url)
    hints = viewer.page.locator(".hint:visible")
    expect(hints.first).to_be_visible()
    shown = hints.count()
    hints.first.get_by_role("button").click()
    expect(hints).to_have_count(shown - 1)
    viewer.page.reload()
    expect(viewer.page.locator("#tissue-label")).to_be_visible()
    expect(hints).to_have_count(shown - 1)
    viewer.page.keyboard.press("?")
    viewer.page.get_by_role("button", name="Explain the page again").click()
    expect(hints).to_have_count(shown)


@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
def test_a_double_click_deletes_nothing_and_what_is_deleted_comes_back(service, watch, size):
    width, height = size
    names = [f"{name}-{width}.lvm" for name in ("old", "older")]
    paths = [service.data / "recordings" / name for name in names]
    for path in paths:
        path.write_text("LabVIEW Measurement\n")
    viewer = watch(service.url + "/recordings", width=width, height=height)
    row, other = (viewer.at("recordings").get_by_role("row").filter(has_text=name) for name in names)
    delete, yes = row.get_by_test_id("recording-delete"), row.get_by_test_id("confirm-yes")
    delete.scroll_into_view_if_needed()
    finger = delete.bounding_box()
    delete.dblclick()
    expect(row.get_by_test_id("confirm")).to_contain_text("to the bin?")
    expect(yes).to_be_disabled()
    viewer.page.mouse.dblclick(finger["x"] + finger["width"] / 2, finger["y"] + finger["height"] / 2)
    viewer.page.wait_for_timeout(1500)
    assert all(path.exists() for path in paths)
    if not yes.is_visible():
        delete.click()
    expect(yes).to_be_enabled()
    asked, under = yes.bounding_box(), delete.bounding_box()
    assert not overlap(asked, finger)
    assert not overlap(asked, under)
    yes.dblclick()
    if viewer.page.locator("#person-name").is_visible():
        viewer.page.locator("#person-name").fill("Ada")
        viewer.page.locator("#person-name").press("Enter")
    expect(row).to_have_count(0)
    expect(other).to_have_count(1)
    assert [path.exists() for path in paths] == [False, True]
    line = service.http.get("/api/audit", params={"kind": "deleted"}).json()[0]
    assert (line["by"], line["file"]["name"]) == ("Ada", names[0])
    binned = viewer.at("bin").get_by_role("row").filter(has_text=names[0])
    expect(binned).to_contain_text("by Ada")
    viewer.page.wait_for_timeout(1000)
    binned.get_by_test_id("bin-restore").click()
    expect(row).to_have_count(1)
    expect(binned).to_have_count(0)
    assert all(path.exists() for path in paths)
    for path in paths:
        path.unlink()


def test_an_admin_empties_the_bin_after_a_question(service, watch):
    service.http.delete("/api/bin", params={"by": "Ada"})
    (service.data / "recordings" / "last.lvm").write_text("LabVIEW Measurement\n")
    service.http.delete("/api/recordings/last.lvm", params={"by": "Ada"})
    viewer = watch(service.url + "/recordings")
    viewer.page.evaluate("localStorage.setItem('graspwatch-person', 'Grace')")
    expect(viewer.at("bin")).to_contain_text("last.lvm")
    viewer.at("bin-empty").dblclick()
    viewer.page.wait_for_timeout(1000)
    assert len(service.http.get("/api/bin").json()["recordings"]) == 1
    viewer.at("bin").get_by_test_id("confirm-yes").click()
    expect(viewer.at("bin-count")).to_have_text("Nothing is in the bin.")
    assert service.http.get("/api/bin").json()["recordings"] == []
    assert service.http.get("/api/audit", params={"kind": "emptied"}).json()[0]["by"] == "Grace"


def overlap(one, other):
    """Whether two boxes of the page have a place in common."""
    return all(
        one[at] < other[at] + other[size] and other[at] < one[at] + one[size]
        for at, size in (("x", "width"), ("y", "height"))
    )


def test_recordings_are_listed_found_and_opened(service, watch):
    viewer = watch(service.url + "/recordings")
    expect(viewer.at("recordings")).to_contain_text("gallbladder.lvm")
    expect(viewer.at("recordings")).to_contain_text("broken.lvm")
    expect(viewer.at("recordings")).to_contain_text("expected")  # why the broken one cannot be read
    viewer.page.keyboard.press("/")
    viewer.page.keyboard.type("gall")
    expect(viewer.at("recordings")).not_to_contain_text("broken.lvm")
    viewer.at("recording-link").first.click()
    expect(viewer.at("replay-bar")).to_be_visible()


def test_a_replay_plays_pauses_seeks_and_is_marked_as_one(service, watch):
    viewer = watch(service.url + EVERY_PAGE["replay"])
    play, position = viewer.at("replay-play"), viewer.at("replay-position")
    expect(viewer.at("replay-bar")).to_contain_text("REPLAY")
    expect(play).to_be_enabled()
    if play.inner_text() == "Play":
        play.click()
    expect(viewer.at("tissue-label")).to_have_text("Gallbladder")
    expect(viewer.at("tool-kind")).to_contain_text("SIMULATED")  # the live tool stays in sight
    expect(viewer.at("force-limit")).to_have_text("No limit: this recording does not say any")
    expect(viewer.at("force-threshold")).to_contain_text("Alarms by the injury threshold of")
    viewer.page.keyboard.press(" ")
    expect(play).to_have_text("Play")
    at = float(position.input_value())
    viewer.page.wait_for_timeout(500)
    assert float(position.input_value()) == at
    viewer.page.keyboard.press("]")
    expect(position).not_to_have_value(f"{at:.2f}")
    viewer.at("replay-speed").select_option("10")
    viewer.page.keyboard.press(" ")
    expect(play).to_have_text("Play")  # at its end
    expect(viewer.at("grasps").locator("tbody tr")).to_have_count(3)
    assert viewer.complaints == []


def test_a_broken_recording_says_why_it_cannot_be_shown(service, watch):
    viewer = watch(service.url + "/recordings/broken.lvm")
    expect(viewer.at("replay-bar")).to_contain_text("cannot be shown")
    expect(viewer.at("replay-bar")).to_contain_text("broken.lvm")


def test_the_tissue_library_tells_every_profile(service, watch):
    viewer = watch(service.url + "/tissues")
    for name in ("Liver", "Small bowel", "Bladder", "Gallbladder"):
        expect(viewer.at("tissues-table")).to_contain_text(name)


def test_the_system_page_tells_versions_calibration_and_what_happened(service, watch):
    viewer = watch(service.url + "/system")
    expect(viewer.at("system-versions")).to_contain_text("nidaqmx")
    expect(viewer.at("calibration")).to_contain_text("scale exactly 1.0: simulated")
    constants = viewer.at("calibration-constants").locator("tr")
    expect(constants).to_have_count(7)
    for row in constants.all():
        expect(row).to_contain_text("2026-11-22")
        expect(row).to_contain_text("not said")
    expect(viewer.at("system-realtime")).to_contain_text("priority")
    expect(viewer.at("journal")).to_contain_text("Run finished")
    expect(viewer.at("chain")).to_contain_text("none changed or missing")
    viewer.page.locator("#journal-kinds").get_by_role("button", name="Request").click()
    expect(viewer.at("journal")).to_contain_text("Start run trapezoid_4hz on liver: done")
    expect(viewer.at("journal")).to_contain_text("from 127.0.0.1")
    with viewer.page.expect_download() as saved:
        viewer.at("chain").get_by_role("link", name="Save as CSV").click()
    assert "Start run trapezoid_4hz" in saved.value.path().read_text()


def test_a_study_is_started_watched_and_stopped(service, watch):
    viewer = watch(service.url + "/studies")
    form = viewer.at("study-form")
    expect(form.locator("option")).not_to_have_count(0)
    viewer.at("study-start").click()
    expect(viewer.at("study-progress")).to_be_visible()
    viewer.at("study-stop").click()
    expect(viewer.at("studies-table")).to_contain_text("stopped")


def test_a_calibration_is_guided_reading_by_reading_to_its_file(service, watch):
    viewer = watch(service.url + "/system")
    viewer.at("calibrate-link").click()
    viewer.at("calibrate-what").select_option("strain")
    viewer.at("calibrate-values").fill("0, 5, 10")
    viewer.at("calibrate-begin").click()
    expect(viewer.at("calibrate-message")).to_contain_text("3 different pulls tell no line from a curve")
    viewer.at("calibrate-values").fill("0, 5, 10, 15")
    viewer.at("calibrate-person").fill("a test")
    viewer.at("calibrate-begin").click()
    expect(viewer.at("reading-do")).to_have_text("1 of 4: Hang nothing on the handle.")
    for n, pull in enumerate((5, 10, 15), 2):
        viewer.at("reading-take").click()
        expect(viewer.at("reading-do")).to_contain_text(f"{n} of 4: Hang a pull of {pull} N")
    viewer.at("reading-take").click()
    expect(viewer.at("fit-table")).to_contain_text("calibration.newton_per_volt")
    expect(viewer.page.locator("#fit-plot .reading")).to_have_count(4)
    expect(viewer.at("fit-file")).to_contain_text(str(service.data / "tools"))
