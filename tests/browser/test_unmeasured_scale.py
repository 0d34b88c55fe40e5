"""A real tool whose force scale is not measured, on the page: an admin gives a reason, then it may move."""

import pytest
from boards import HAS_DRIVER, ServedBoard
from playwright.sync_api import expect
from service import Service

pytestmark = [pytest.mark.browser, pytest.mark.skipif(HAS_DRIVER, reason="the driver of a real board is installed")]


def test_an_admin_arms_it_with_a_reason_that_goes_into_the_journal(calm, watch, tmp_path):
    with (
        ServedBoard(tmp_path, measured=False) as board,
        Service("serve", *calm, "--tool", str(board.tool_file)) as service,
    ):
        viewer = watch(service.url)
        viewer.at("arm").click()
        expect(viewer.at("run-message")).to_contain_text("force scale is not measured")
        viewer.at("scale-reason").fill("foam in the jaws")
        viewer.at("arm").click()
        expect(viewer.at("phase")).to_have_text("ARMED")
        texts = [line["text"] for line in service.http.get("/api/journal").json()]
        assert any("without a measured force scale: foam in the jaws" in text for text in texts)
