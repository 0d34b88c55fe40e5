"""Signing in on the page, and what each role finds there."""

import pytest
from axe_playwright_python.sync_playwright import Axe
from people import bearer, give_tokens
from playwright.sync_api import expect
from service import Service

from app.messages.people import Role
from app.people import tokens

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def token(data):
    (data / "recordings").mkdir()
    (data / "recordings" / "some.lvm").write_text("LabVIEW Measurement\n")
    return give_tokens(data)


@pytest.fixture(scope="module")
def running_service(calm, data, token):
    with Service("serve", *calm, "--host", "0.0.0.0", data=data) as running:
        yield running


@pytest.fixture
def service(running_service, token):
    yield running_service
    headers = bearer(token[Role.ADMIN])
    running_service.http.post("/api/stop", headers=headers)
    running_service.http.post("/api/control", json={"take_over": True}, headers=headers)
    running_service.http.delete("/api/control", headers=headers)


def signed_in(watch, service, token):
    viewer = watch(service.url)
    viewer.at("sign-in-token").fill(token)
    viewer.at("sign-in-send").click()
    expect(viewer.at("tool-kind")).to_have_text("SIMULATED")
    return viewer


def test_a_stranger_sees_nothing_but_the_sign_in_until_his_token_is_good(service, watch, token):
    viewer = watch(service.url)
    expect(viewer.at("sign-in")).to_be_visible()
    expect(viewer.at("tool-kind")).to_have_text("NOT CONNECTED")
    assert viewer.page.locator("main").inner_text() == ""
    results = Axe().run(viewer.page)
    assert results.violations_count == 0, results.generate_report()
    viewer.at("sign-in-token").fill("wrong")
    viewer.page.keyboard.press("Enter")
    expect(viewer.at("sign-in-message")).to_contain_text("wrong, expired or taken back")
    viewer.at("sign-in-token").fill(token[Role.OPERATOR])
    viewer.page.keyboard.press("Enter")
    expect(viewer.at("person")).to_have_text("Otto · operator")
    expect(viewer.at("sign-in")).to_be_hidden()
    viewer.at("person").click()
    viewer.at("sign-out").click()
    expect(viewer.at("sign-in-token")).to_be_visible()
    expect(viewer.at("person")).to_have_text("Sign in")
    assert token[Role.OPERATOR] not in viewer.page.evaluate("JSON.stringify([localStorage, document.cookie])")


def test_a_viewer_has_stop_and_no_button_that_would_be_refused(service, watch, token):
    admin = bearer(token[Role.ADMIN])
    service.http.post("/api/runs", json={"protocol": "trapezoid_025hz", "cycles": 20}, headers=admin)
    viewer = signed_in(watch, service, token[Role.VIEWER])
    viewer.page.keyboard.press("v")  # a viewer finds the OR view
    expect(viewer.at("run-now")).to_contain_text("Running")
    expect(viewer.at("start")).to_be_hidden()
    expect(viewer.at("control-take")).to_be_hidden()
    viewer.page.keyboard.press("Shift+S")
    for page, there, hidden in (
        ("recordings", "some.lvm", "recording-delete"),
        ("studies", "No study is under way", "study-form"),
    ):
        viewer.page.locator(f"nav [data-page={page}]").click()
        expect(viewer.page.locator("main").get_by_text(there).first).to_be_visible()
        expect(viewer.at(hidden).first).to_be_hidden()
    viewer.at("stop").click()
    expect(viewer.at("stop-message")).to_contain_text("STOPPED trapezoid_025hz")
    assert [text for text in viewer.complaints if "403" in text] == []


def test_an_admin_finds_all_buttons(service, watch, token):
    viewer = signed_in(watch, service, token[Role.ADMIN])
    expect(viewer.at("start")).to_be_visible()
    viewer.page.locator("nav [data-page=recordings]").click()
    expect(viewer.at("recording-delete").first).to_be_visible()


def test_control_is_seen_refused_taken_over_and_given_back(service, watch, token):
    service.http.post("/api/control", json={}, headers=bearer(token[Role.ADMIN]))
    viewer = signed_in(watch, service, token[Role.OPERATOR])
    expect(viewer.at("control")).to_contain_text("Ada has control")
    expect(viewer.at("protocol").locator("option")).not_to_have_count(0)
    viewer.at("start").click()
    expect(viewer.at("run-message")).to_contain_text("Ada has control")
    viewer.at("control-take").click()
    expect(viewer.at("control")).to_contain_text("You have control")
    viewer.at("control-give").click()
    expect(viewer.at("control")).to_be_hidden()
    viewer.start("trapezoid_025hz", 3, "bladder")
    expect(viewer.at("control")).to_contain_text("You have control")


def test_a_page_whose_token_was_taken_back_asks_for_another(service, watch, data):
    viewer = signed_in(watch, service, tokens.add_token(data, "Eve", Role.VIEWER))
    tokens.revoke_token(data, "Eve")
    expect(viewer.at("sign-in-token")).to_be_visible()
    expect(viewer.at("tool-kind")).to_have_text("NOT CONNECTED")
