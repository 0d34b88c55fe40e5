"""The page of the files that are chosen by name: add, preview, change, delete, and use a calibration."""

import re
from datetime import date
from pathlib import Path

import pytest
from closings_table import CLOSINGS, write_closings_table
from playwright.sync_api import expect
from service import Service, until

from config.writing import write_calibrated_tool

pytestmark = pytest.mark.browser


def test_a_protocol_is_added_previewed_changed_and_chosen_and_a_calibration_is_used(service: Service, watch) -> None:
    (service.data / "tools").mkdir(exist_ok=True)
    file = write_calibrated_tool(
        "simulated", {"calibration.newton_per_volt": 12.5}, [], date.today(), service.data / "tools"
    )
    viewer = watch(service.url + "/configuration")
    page, text, message = viewer.page, viewer.at("file-text"), viewer.at("file-message")
    own = page.locator("tr[data-name=my_steps]")
    viewer.at("file-check").click()
    expect(viewer.at("file-preview")).to_contain_text("up to 1.0 V")
    expect(viewer.at("file-preview").locator("polyline")).to_have_count(1)
    viewer.at("file-save").click()
    expect(message).to_have_text("Saved as my_steps.")
    expect(own).to_contain_text("yours")

    right = text.input_value()
    text.fill(right.replace("rest_s = 1.0", "rest_s = -1.0").replace("title", "titel"))
    viewer.at("file-save").click()
    expect(viewer.at("file-problems").locator("li")).to_have_count(3)
    expect(message).to_contain_text("Not saved")
    wrong, discard = text.input_value(), page.locator("section:has(#file-form)").get_by_test_id("confirm-yes")
    own.get_by_role("button", name="Edit").click()
    expect(discard).to_be_visible()
    own.get_by_role("button", name="Edit").click()
    expect(discard).to_be_visible()
    expect(text).to_have_value(wrong)
    page.get_by_role("link", name="Live").click()
    page.get_by_role("link", name="Add or change one").click()
    expect(text).to_have_value(wrong)
    own.get_by_role("button", name="Edit").click()
    discard.click()
    expect(text).to_have_value(right)
    text.fill(right.replace("My steps", "My other steps"))
    viewer.at("file-save").click()
    expect(own).to_contain_text("My other steps")
    assert 'title = "My other steps"' in Path(service.data / "protocols/my_steps.toml").read_text()

    page.get_by_role("link", name="Live").click()
    viewer.at("protocol").select_option("my_steps")
    expect(page.locator("#waveform-facts")).to_contain_text("up to 1.0 V")
    page.get_by_role("link", name="Add or change one").click()
    page.locator("tr[data-name=porcine]").get_by_role("button", name="Open").click()
    expect(viewer.at("file-tissues")).to_contain_text("Liver")

    calibrated = page.locator(f"tr[data-name='{file.stem}']")
    page.wait_for_timeout(700)  # a second press soon after another one counts as a double click
    calibrated.get_by_role("button", name="Use").first.click()
    calibrated.get_by_test_id("confirm-yes").locator("visible=true").click()
    expect(message).to_contain_text(f"{file.stem} is used from now on")
    expect(calibrated).to_contain_text("The service uses this tool file")
    until(lambda: service.http.get("/api/health").json()["detail"] == "idle")
    assert service.http.get("/api/system").json()["tool"]["calibration"]["newton_per_volt"] == 12.5
    own.get_by_role("button", name="Delete").first.click()
    own.get_by_test_id("confirm-yes").click()
    expect(own).to_have_count(0)
    assert not (service.data / "protocols/my_steps.toml").exists()
    assert viewer.complaints == []


def test_a_tool_file_is_made_from_a_recording(service: Service, watch, tmp_path: Path) -> None:
    viewer = watch(service.url + "/configuration")
    page, message = viewer.page, viewer.at("draft-message")
    viewer.at("draft-file").set_input_files(write_closings_table(tmp_path / "mine.csv"))
    expect(message).to_have_text("4 columns. Say what they are.")
    expect(viewer.at("draft-columns").locator("tbody tr")).to_have_count(4)
    expect(page.locator("#draft-times")).to_contain_text("500 samples a second")
    viewer.at("draft-make").click()
    expect(message).to_have_text("No tool file: choose the columns of force and position")
    viewer.at("draft-force").select_option("4")
    viewer.at("draft-position").select_option("3")
    viewer.at("draft-newton").fill("0.01")
    viewer.at("draft-name").fill("mine")
    viewer.at("draft-make").click()
    expect(message).to_contain_text(f"{CLOSINGS} grasps were found. Assumed: the millimetres.", timeout=30_000)
    expect(viewer.at("draft-grasps").locator("tbody tr").first).to_contain_text("3.0")
    expect(viewer.at("file-text")).to_have_value(re.compile('name = "mine"'))
    viewer.at("file-save").click()
    expect(viewer.at("file-message")).to_have_text("Saved as mine.")
    expect(page.locator("tr[data-name=mine]")).to_contain_text("yours")
    words = tmp_path / "words.txt"
    words.write_text("no numbers here\n")
    viewer.at("draft-file").set_input_files(words)
    expect(message).to_contain_text("Not read: words.txt")
