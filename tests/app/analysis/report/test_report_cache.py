"""The service's reports: made once, kept, made anew for another file, bounded, and mended after a failure."""

import asyncio
import os

import pytest
from simulation import joined, simulate_raw, write_lvm

from app.analysis.report import report_cache
from app.analysis.report.report_cache import ReportCache
from config.errors import RecordingError, RefusedError
from config.service_plan import ServicePlan


@pytest.fixture
def plan(tool, library, settings, tmp_path):
    return ServicePlan(tool, library, settings, "liver", 0, tmp_path, tool)


@pytest.fixture
def path(tmp_path):
    return write_lvm(tmp_path / "liver.lvm", joined(simulate_raw("liver", "trapezoid_4hz")))


async def finished(shelf, path):
    """The page, and the shares that were told before."""
    shares = []
    while isinstance(answer := await shelf.request_report(path), float):
        shares.append(answer)
        await asyncio.sleep(0.02)
    return answer, shares


def test_it_is_made_once_and_again_for_a_file_that_has_changed(plan, path):
    async def scenario():
        shelf = ReportCache(plan)
        page, shares = await finished(shelf, path)
        assert shares == sorted(shares)
        assert "Report: liver.lvm" in page.read_text()
        assert page.parent == plan.reports_folder
        assert await ReportCache(plan).request_report(path) == page  # another service finds it
        for damaged in (b"", page.read_bytes()[:-100]):
            page.write_bytes(damaged)
            assert await shelf.find_report(path) is None
        os.utime(path, ns=(1, 1))
        assert await shelf.request_report(path) == 0.0
        await shelf.aclose()

    asyncio.run(scenario())


def test_a_failure_is_told_once_and_then_it_is_tried_again(plan, tmp_path):
    (tmp_path / "broken.lvm").write_text("LabVIEW Measurement\n")

    async def scenario():
        shelf = ReportCache(plan)
        with pytest.raises(RecordingError, match=r"^broken\.lvm"):
            await finished(shelf, tmp_path / "broken.lvm")
        assert await shelf.request_report(tmp_path / "broken.lvm") == 0.0
        await shelf.aclose()
        with pytest.raises(RecordingError, match="cannot be read"):
            await shelf.request_report(tmp_path / "none.lvm")

    asyncio.run(scenario())


def test_not_more_wait_than_are_allowed(plan, path, tmp_path, monkeypatch):
    monkeypatch.setattr(report_cache, "MAX_PENDING_REPORTS", 1)
    other = tmp_path / "other.lvm"
    other.write_bytes(path.read_bytes())

    async def scenario():
        shelf = ReportCache(plan)
        await shelf.request_report(path)
        await shelf.request_report(path)  # the same is no other
        with pytest.raises(RefusedError, match="Ask again"):
            await shelf.request_report(other)
        await shelf.aclose()

    asyncio.run(scenario())


def test_only_the_pages_read_last_are_kept(plan, path, monkeypatch):
    monkeypatch.setattr(report_cache, "MAX_PAGES", 2)
    plan.reports_folder.mkdir()
    for age_s, name in enumerate(("new", "older", "oldest")):
        (plan.reports_folder / f"{name}.html").write_text("")
        os.utime(plan.reports_folder / f"{name}.html", (1e9 - age_s, 1e9 - age_s))
    page, _ = asyncio.run(finished(ReportCache(plan), path))
    assert {*plan.reports_folder.iterdir()} == {page, plan.reports_folder / "new.html"}
