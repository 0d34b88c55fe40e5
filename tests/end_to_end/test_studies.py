"""Studies from the dashboard: real service, real processes, real Chromium."""

import os
import shutil
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright
from prometheus_client.parser import text_string_to_metric_families
from service import Service, until

from app.analysis.study_runner import StudyRunner

ENDED_WITHIN_S = 2.0


@pytest.fixture(scope="module")
def service():
    with Service("serve") as running:
        yield running


def start(service, **body):
    response = service.http.post("/api/studies", json={"study": "identify", **body})
    assert response.status_code == 201, response.text
    return response.json()


def look_up(service, study_id):
    return service.http.get(f"/api/studies/{study_id}").json()


def over(service, study_id, timeout_s=60.0):
    def ended():
        study = look_up(service, study_id)
        return study if study["state"] != "running" else None

    return until(ended, timeout_s)


def tree(pid):
    """A process and all that came from it."""
    children = [path.read_text().split() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    return [pid, *(each for found in children for child in found for each in tree(int(child)))]


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def processes_at_work(service):
    """The study's own and its pool's, as soon as there are both."""
    study = service.worker("study")
    return until(lambda: found if len(found := tree(study)) > 1 else None, 90.0)  # of low priority


def all_ended(processes):
    return until(lambda: not any(map(alive, processes)), ENDED_WITHIN_S)


def samples(service):
    """Received, and lost, since the service started."""
    families = text_string_to_metric_families(service.http.get("/metrics").text)
    values = {sample.name: sample.value for family in families for sample in family.samples}
    return values["graspwatch_samples_total"], values["graspwatch_lost_samples_total"]


def look_at(url):
    """What Chromium makes of a report: plots with something drawn in them, and complaints."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if not program:
        reason = "no Chromium on this machine (Debian: apt install chromium)"
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)(reason)

    def look():
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
            page, complaints = browser.new_page(), []
            page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.goto(url)
            plots = page.locator(".js-plotly-plot")
            plots.last.locator(".trace").first.wait_for(state="attached")
            drawn = [plots.nth(i).locator(".trace").count() for i in range(plots.count())]
            browser.close()
            return drawn, complaints

    with ThreadPoolExecutor(1) as elsewhere:  # other tests' Chromium holds this thread
        return elsewhere.submit(look).result()


@pytest.fixture(scope="module")
def watched(service):
    """A study watched from its start to its end: its states, and what happened meanwhile."""
    before, begin_s = samples(service), time.monotonic()
    states = [start(service, grasps=3, by="Ann")]
    second = service.http.post("/api/studies", json={"study": "paper"})
    while states[-1]["state"] == "running":
        assert time.monotonic() - begin_s < 150.0
        time.sleep(0.05)
        states.append(look_up(service, states[0]["id"]))
    after, end_s = samples(service), time.monotonic()
    return states, second, (after[0] - before[0]) / (end_s - begin_s), after[1] - before[1]


def test_a_study_tells_how_far_it_is_and_finishes(service, watched):
    states, *_ = watched
    begun, ended = states[0], states[-1]
    assert (begun["study"], begun["grasps"], begun["seed"], begun["by"]) == ("identify", 3, 0, "Ann")
    done = [state["done"] for state in states]
    assert done == sorted(done)
    assert len(set(done)) >= 3
    assert (ended["state"], ended["done"], ended["of"], ended["why"]) == ("finished", 12, 12, None)
    listed = service.http.get("/api/studies").json()
    assert ended in listed["runs"]
    assert [study["name"] for study in listed["available"]][:2] == ["paper", "identify"]
    told = [(entry["text"].split(":")[0], entry["by"]) for entry in service.http.get("/api/journal").json()]
    assert ("Study started", "Ann") in told
    assert ("Study finished", None) in told


def test_one_study_at_a_time(watched):
    states, second, *_ = watched
    assert second.status_code == 409
    assert states[0]["title"].rstrip(".") in second.json()["detail"]


def test_a_live_tool_loses_nothing_to_a_study(watched):
    *_, rate_hz, lost = watched
    assert lost == 0
    assert rate_hz == pytest.approx(1000.0, rel=0.1)


@pytest.mark.browser
def test_its_report_draws_its_plots_under_a_policy_of_its_own(service, watched):
    study = watched[0][-1]
    page = service.http.get(study["report"])
    assert "sandbox allow-scripts" in page.headers["content-security-policy"]
    assert "'self'" not in page.headers["content-security-policy"]
    drawn, complaints = look_at(service.url + study["report"])
    assert len(drawn) == 3
    assert all(drawn)
    assert not complaints
    figures = service.http.get(f"/api/studies/{study['id']}/figures").json()
    assert figures["settings"]["grasps of each tissue"] == 3
    assert figures["figures"][0]["name"] == "Bayes limit"


@pytest.mark.parametrize(
    ("body", "field", "told"),
    [
        ({"study": "identfy"}, "study", "Did you mean 'identify'?"),
        ({"study": "paper", "grasps": 1001}, "grasps", "at most 1000"),
        ({"study": "identify", "grasps": 0}, "grasps", "greater than or equal to 1"),
        ({"study": "identify", "seed": -1}, "seed", "greater than or equal to 0"),
        ({}, "study", "required"),
    ],
)
def test_a_wrong_request_is_refused_by_its_field(service, body, field, told):
    refused = service.http.post("/api/studies", json=body)
    assert refused.status_code == 422
    assert [error["field"] for error in refused.json()["errors"]] == [field]
    assert told in refused.json()["detail"]


@pytest.mark.parametrize("what", ["", "/report", "/figures"])
@pytest.mark.parametrize("study_id", ["20260101-000000-identify", "%2e%2e", "..%2f..%2fjournal.jsonl", "..%2fstudies"])
def test_an_id_that_is_none_leads_nowhere(service, study_id, what):
    refused = service.http.get(f"/api/studies/{study_id}{what}")
    assert refused.status_code == 404
    assert refused.headers["content-type"] == "application/problem+json"


def test_a_stop_ends_all_its_processes(service):
    study = start(service, grasps=1000)
    processes = processes_at_work(service)
    assert os.getpriority(os.PRIO_PROCESS, processes[-1]) == 10
    stopped = service.http.post(f"/api/studies/{study['id']}/stop", json={"by": "Bob"}).json()
    all_ended(processes)
    assert (stopped["state"], stopped["why"], stopped["report"]) == ("stopped", "asked to stop", None)
    assert service.http.get(f"/api/studies/{study['id']}/report").status_code == 404
    asked, told = service.http.get("/api/journal", params={"most": 2}).json()
    assert (told["text"].split(" (")[0], told["by"]) == ("Study stopped: identify", "Bob")
    assert (asked["text"], asked["by"]) == (f"Stop study {study['id']}: done", "Bob")
    assert service.http.post(f"/api/studies/{study['id']}/stop").json() == stopped


def test_a_study_can_be_stopped_before_it_has_begun_and_started_again_in_the_same_second(service):
    studies = []
    for _ in range(3):
        studies.append(start(service)["id"])
        stopped = service.http.post(f"/api/studies/{studies[-1]}/stop").json()
        assert stopped["state"] == "stopped"
    assert len(set(studies)) == 3


@pytest.mark.parametrize(("which", "told"), [(0, "fewer grasps"), (-1, "A process of the study died")])
def test_a_killed_process_is_told_as_failed(service, which, told):
    study = start(service, grasps=1000)
    processes = processes_at_work(service)
    os.kill(processes[which], signal.SIGKILL)
    failed = over(service, study["id"])
    all_ended(processes)
    assert failed["state"] == "failed"
    assert told in failed["why"]
    assert "memory" in failed["why"]


@pytest.mark.long
def test_studies_outlast_the_service_but_their_processes_do_not(service, watched, caplog):
    study, finished, folder = start(service, grasps=1000), watched[0][-1], service.data / "studies"
    processes = processes_at_work(service)
    service.end()
    all_ended(processes)
    (folder / "damaged").mkdir()
    (folder / "damaged" / "study.json").write_text("{")
    another = Service("serve")
    another.data = service.data
    with another as again:
        left = look_up(again, study["id"])
        assert (left["state"], left["why"]) == ("stopped", "the service was ended")
        assert look_up(again, finished["id"]) == finished
        assert "Plotly" in again.http.get(finished["report"]).text
        assert look_up(again, "damaged")["status"] == 404
        study = start(again, grasps=1000)
        assert again.http.get("/api/studies").json()["runs"][0]["id"] == study["id"]
        processes = processes_at_work(again)
        again.process.kill()
        all_ended(processes)
    left = StudyRunner(folder, print).get(study["id"])
    assert left.state == "failed"
    assert "service died" in left.why
    assert [record.message for record in caplog.records if "damaged" in record.message]
