"""A recording's report as a person meets it: made by the service, opened from the dashboard, printed."""

import re

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect
from reports import simulated_story
from service import Service, until
from simulation import joined, simulate_raw, write_lvm
from watched import Watched

from app.analysis.report.page import render_report_page as report_page
from app.analysis.report.report import Report, analyze_recordings

pytestmark = pytest.mark.browser
A4_PX = 695  # what A4 leaves between the page's margins


@pytest.fixture(scope="module")
def running_service(calm):
    with Service("serve", *calm) as running:
        grasps = joined(simulate_raw("gallbladder", "trapezoid_2hz", cycles=3))
        write_lvm(running.data / "recordings" / "gallbladder.lvm", grasps)
        (running.data / "recordings" / "broken.lvm").write_text("LabVIEW Measurement\n")
        yield running


def drawn(viewer):
    """The page once all its plots are there."""
    expect(viewer.page.locator("html[data-drawn]")).to_have_count(1)
    return viewer


@pytest.fixture(scope="module")
def several(tmp_path_factory):
    """The page of runs on three tissues, as a file."""
    stories = (*map(simulated_story, ("liver", "bladder")), simulated_story("gallbladder", 2, "strong_2hz"))
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(report_page(Report("Report: 3 runs", stories, {}), lambda _: None))
    return path.as_uri()


@pytest.fixture(scope="module")
def opened(browser, several):
    viewer = drawn(Watched(browser, several, theme="light"))
    yield viewer
    viewer.context.close()


def test_the_dashboard_opens_it_in_a_new_tab_which_shows_how_far_it_is(service, watch):
    viewer = watch(service.url + "/recordings")
    link = viewer.page.get_by_role("link", name="Report of gallbladder.lvm")
    with viewer.page.context.expect_page() as opening:
        link.click()
    tab = opening.value
    complaints = []
    tab.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
    expect(tab.get_by_role("heading", name="Report: gallbladder.lvm")).to_be_visible(timeout=60_000)
    expect(tab.locator("html[data-drawn]")).to_have_count(1)
    assert tab.locator(".js-plotly-plot").count() == 5
    assert not complaints
    kept = [*(service.data / "reports").glob("*.html")]
    assert len(kept) == 1
    answer = service.http.get("/api/recordings/gallbladder.lvm/report")
    assert answer.status_code == 200
    assert "sandbox allow-scripts" in answer.headers["content-security-policy"]
    assert [*(service.data / "reports").glob("*")] == kept


def test_a_program_and_a_browser_are_told_how_far_it_is(service):
    grasps = service.data / "recordings" / "gallbladder.lvm"
    (grasps.parent / "another.lvm").write_bytes(grasps.read_bytes())
    address = "/api/recordings/another.lvm/report"
    begun = service.http.get(address)
    assert (begun.status_code, begun.json()) == (202, {"done": 0.0})
    waiting = service.http.get(address, headers={"accept": "text/html,*/*"})
    assert waiting.status_code == 202
    assert "<progress" in waiting.text
    assert "no-store" in waiting.headers["cache-control"]
    made = until(lambda: answer if (answer := service.http.get(address)).status_code != 202 else None)
    assert made.status_code == 200
    assert "Report: another.lvm" in made.text


def test_a_broken_recording_has_no_report_and_says_why(service, watch):
    viewer = watch(service.url + "/api/recordings/broken.lvm/report")
    expect(viewer.page.get_by_role("heading", name="There is no report")).to_be_visible()
    expect(viewer.page.get_by_role("status")).to_contain_text("broken.lvm")
    assert service.http.get("/api/recordings/none.lvm/report").status_code == 404


def rules_of_axe_are_met(page):
    results = Axe().run(page, context={"exclude": [[".js-plotly-plot"]]})
    assert results.violations_count == 0, results.generate_report()


def test_it_needs_nothing_from_anywhere_and_has_every_section(opened):
    assert opened.requests == [opened.page.url]
    assert not opened.complaints
    assert opened.overflow() <= 0
    plots = opened.page.locator(".js-plotly-plot")
    assert all(plots.nth(i).locator(".trace, .boxlayer").count() for i in range(plots.count()))
    sections = opened.page.locator("h2").all_text_contents()
    assert [sections[0], *sections[2:]] == ["Grasps", "Courses", "Stress over strain", "Statistics", "How it was made"]
    headings = " ".join(opened.page.locator("h3").all_text_contents())
    assert re.search("Table VI:.*Table VII:.*Figure 8.*Tukey.*tells which pair apart", headings)
    rules_of_axe_are_met(opened.page)


def test_its_dark_side_can_be_read(opened):
    page = opened.page
    page.emulate_media(color_scheme="dark")
    rules_of_axe_are_met(page)
    colours = "(part) => getComputedStyle(document.querySelector(part))"
    assert page.evaluate(f"({colours})('.y2tick text').fill") == "rgb(232, 237, 241)"
    assert page.evaluate(f"({colours})('#grasp-course .x2y2 .trace:nth-child(2) path').stroke") == "rgb(255, 255, 255)"


def test_a_grasp_is_chosen_by_keyboard_and_shows_its_own_samples(opened):
    page = opened.page
    third = page.get_by_role("button", name="Grasp 3 of bladder")
    third.focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name=re.compile("^Grasp 3 of bladder"))).to_be_in_viewport()
    expect(third).to_have_attribute("aria-current", "true")
    begin_s, force_n = page.evaluate("""() => {
        const lines = document.getElementById("grasp-course").data;
        return [lines[1].x[0], Math.max(...lines[1].y)];
    }""")
    grasp = simulated_story("bladder").grasps[2]
    assert begin_s == pytest.approx(grasp.start_s, abs=2e-3)
    assert force_n == pytest.approx(grasp.peak_force_n, rel=1e-3)
    page.get_by_role("button", name="Next grasp").press("Enter")
    expect(page.get_by_role("heading", name=re.compile("^Grasp 1 of gallbladder"))).to_be_visible()
    assert page.evaluate("document.getElementById('grasp-course').data.at(-1).hovertext[0]").startswith("high:")


def test_it_prints_white_on_a4_with_no_plot_cut(opened):
    page = opened.page
    page.emulate_media(color_scheme="dark")
    pdf = page.pdf(prefer_css_page_size=True)
    pages = len(re.findall(rb"/Type\s*/Page\b", pdf))
    assert 5 <= pages <= 14
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert (
        page.evaluate("""() => Math.max(...[...document.querySelectorAll(".main-svg")]
        .map((plot) => plot.getBoundingClientRect().width))""")
        <= A4_PX
    )


def test_hundreds_of_grasps_are_a_page_that_can_be_used(browser, tmp_path):
    story = simulated_story("bladder")
    grasps = story.grasps * 100
    many = Report(
        "Report: many",
        (type(story)(**{name: getattr(story, name) for name in story.__dataclass_fields__} | {"grasps": grasps}),),
        {},
    )
    path = tmp_path / "many.html"
    path.write_text(report_page(many, lambda _: None))
    assert path.stat().st_size < 15e6
    viewer = drawn(Watched(browser, path.as_uri()))
    assert viewer.page.locator("button[data-grasp]").count() == 300
    viewer.page.locator("button[data-grasp]").last.press("Enter")
    expect(viewer.page.get_by_role("button", name="Next grasp")).to_be_disabled()
    viewer.context.close()


@pytest.mark.recordings
def test_a_recording_of_the_real_tool_has_a_report(recordings, recording_tool, library, settings, watch, tmp_path):
    path = next(path for path in recordings if path.name.startswith("ureter4Hz"))
    report = analyze_recordings([path], recording_tool, library, settings, {path: "ureter"}, lambda _: None)
    page = tmp_path / "report.html"
    page.write_text(report_page(report, lambda _: None))
    viewer = drawn(watch(page.as_uri()))
    assert not viewer.complaints
    expect(viewer.page.locator("#statistics")).to_contain_text("encoder slips or walks")
    expect(viewer.page.get_by_role("table").first).to_contain_text("Ureter")
