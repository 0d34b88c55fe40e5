"""Laboratory sessions: begun, changed and ended; runs belong to them; they outlive a restart and a rebuild."""

import asyncio
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from service import PROGRAM, Listener, Service, until
from simulation import joined, simulate_raw, write_lvm

from acquisition.recordings.mcap_layout import SESSION_ATTACHMENT
from acquisition.recordings.mcap_reader import McapFile
from app.messages.lab_sessions import LabSession
from app.messages.stored import read_stored
from config.load import CONFIG_DIR
from graspwatch import Graspwatch

PATH = "/api/lab-sessions"
PIG: dict[str, Any] = {"subject": "P-12", "species": "pig", "condition": "in vivo", "operator": "Ada", "by": "Ada"}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    settings = (CONFIG_DIR / "graspwatch.toml").read_text()
    assert "fields = [] " in settings
    config: Path = tmp_path_factory.mktemp("settings") / "laboratory.toml"
    config.write_text(settings.replace("fields = [] ", 'fields = ["cage"] '))
    with Service("serve", "--tissue", "liver", "--config", str(config)) as running:
        yield running


def state(service: Service) -> dict[str, Any]:
    with Listener(service) as viewer:
        viewer.listen(lambda: viewer.of("state"))
        return viewer.of("state")[-1]


def test_runs_belong_to_the_session_under_way(service: Service) -> None:
    assert state(service)["session"] is None
    alone = service.finished(service.run(protocol="trapezoid_4hz", cycles=1)["id"])
    assert alone["session"] is None

    begun = service.http.post(PATH, json={**PIG, "fields": {"cage": "7"}})
    assert begun.status_code == 201, begun.text
    session = begun.json()
    assert state(service)["session"] == session
    run = service.finished(service.run(protocol="trapezoid_4hz", cycles=1)["id"])
    assert run["session"] == session["id"]
    found = service.http.get("/api/runs", params={"session": session["id"]}).json()
    assert [each["id"] for each in found] == [run["id"]]
    content = McapFile(service.recorded(run["id"])).attachments[SESSION_ATTACHMENT]
    assert read_stored(LabSession, content).model_dump(mode="json") == session

    other = service.http.post(PATH, json={**PIG, "subject": "P-13"}).json()  # ends the one before
    listed = service.http.get(PATH).json()
    assert [(each["subject"], each["ended_at"] is None) for each in listed] == [("P-13", True), ("P-12", False)]
    assert service.http.delete(f"{PATH}/current").json()["id"] == other["id"]
    assert service.http.delete(f"{PATH}/current").status_code == 404
    assert state(service)["session"] is None


def test_the_table_of_all_grasps_has_what_was_said_since(service: Service) -> None:
    session = service.http.post(PATH, json={**PIG, "protocol_number": "2026-17", "fields": {"cage": "7"}}).json()
    run = service.finished(service.run(protocol="trapezoid_4hz", cycles=2)["id"])
    service.recorded(run["id"])
    until(lambda: len(service.http.get(f"/api/runs/{run['id']}/grasps").json()) == 2)
    service.http.put(f"/api/runs/{run['id']}/grasps/2/truth", json={"held": "liver", "version": 0, "by": "Ada"})
    service.http.put(f"{PATH}/{session['id']}", json={**PIG, "subject": "P-21", "fields": {"cage": "8"}, "version": 1})

    async def fetch() -> list[dict[str, Any]]:
        async with Graspwatch(service.url) as tool:
            return (await tool.grasp_table()).to_pylist()

    rows = [row for row in asyncio.run(fetch()) if row["run_id"] == run["id"]]
    assert [(row["index"], row["truth"], row["subject"]) for row in rows] == [(1, None, "P-21"), (2, "liver", "P-21")]
    assert {(row["protocol_number"], row["field_cage"]) for row in rows} == {(None, "8")}  # as changed since
    assert 0.0 < rows[0]["start_s"] < rows[0]["end_s"] < rows[1]["start_s"] < 10.0  # from the run's start on

    def find(text: str) -> list[dict[str, Any]]:
        return service.http.get("/api/recordings", params={"q": text}).json()["recordings"]

    [listed] = until(lambda: find("p-21 liver"))  # once its file has been read
    assert (listed["run_id"], listed["subject"], listed["held"]) == (run["id"], "P-21", ["liver"])
    assert len(listed["labels"]) == 2
    assert find("p-21 kidney") == []

    page = service.http.get("/api/evaluation", params={"library": "porcine"}, timeout=60)
    assert (page.status_code, "By truth: porcine" in page.text) == (200, True), page.text[:500]
    assert "sandbox" in page.headers["Content-Security-Policy"]
    for name in ("none", "/etc/passwd", "../graspwatch.toml"):
        assert service.http.get("/api/evaluation", params={"library": name}).status_code == 422

    broken = service.data / "recordings/broken.mcap"
    broken.write_bytes(b"no recording")
    answer = service.http.get("/api/grasps.csv")
    broken.unlink()
    assert answer.headers["X-Left-Out"] == "1"
    assert "grasps.csv" in answer.headers["Content-Disposition"]
    assert answer.text.splitlines()[0].startswith('"recording","run_id"')
    assert service.http.get("/api/grasps.xlsx").status_code == 422


def test_a_change_has_a_version_and_a_name_is_no_code(service: Service) -> None:
    session = service.http.post(PATH, json=PIG).json()

    def change(**values: Any) -> tuple[int, dict[str, Any]]:
        answer = service.http.put(f"{PATH}/{session['id']}", json={**PIG, **values})
        return answer.status_code, answer.json()

    status, changed = change(version=1, condition="ex vivo", by="Grace")
    assert (status, changed["version"], changed["condition"], changed["by"]) == (200, 2, "ex vivo", "Grace")
    status, problem = change(version=1, condition="in situ")
    assert (status, "Grace has changed this session meanwhile" in problem["detail"]) == (409, True)
    status, problem = change(version=2, subject="Rosa the pig")
    assert (status, "is no code of a subject" in problem["detail"]) == (422, True)
    status, problem = change(version=2, fields={"shelf": "1"})
    assert (status, "the settings know cage" in problem["detail"]) == (422, True)
    assert change(version=2, condition="dreamt")[0] == 422
    assert service.http.put(f"{PATH}/none", json={**PIG, "version": 1}).status_code == 404
    lines = service.http.get("/api/audit", params={"kind": "session", "limit": 2}).json()
    assert [line["lab_session"]["version"] for line in lines] == [2, 1]


def test_a_session_goes_on_after_a_restart_and_a_rebuild_of_the_index() -> None:
    with Service("serve", "--tissue", "liver") as first:
        session = first.http.post(PATH, json=PIG).json()
        until(lambda: first.http.get(PATH).json())
        first.end()
        subprocess.run([PROGRAM, "index", "--rebuild", "--data", first.data], check=True, capture_output=True)
        with Service("serve", data=first.data) as again:
            assert state(again)["session"]["id"] == session["id"]
            run = again.run(protocol="trapezoid_4hz", cycles=1)
            assert run["session"] == session["id"]


def test_an_imported_recording_belongs_to_the_session_that_is_named(service: Service, tmp_path: Path) -> None:
    log = tmp_path / "afterwards.lvm"
    write_lvm(log, joined(simulate_raw("liver", "trapezoid_4hz")))

    def take_in(session: str) -> subprocess.CompletedProcess[str]:
        command = [PROGRAM, "import", log, "--tool", "simulated", "--session", session, "--data", service.data]
        return subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)

    service.http.delete(f"{PATH}/current")
    refused = take_in("now")
    assert (refused.returncode, "no laboratory session under way" in refused.stderr) == (2, True)
    session = service.http.post(PATH, json=PIG).json()
    assert take_in("now").returncode == 0
    service.http.delete(f"{PATH}/current")
    content = McapFile(service.data / "recordings" / "afterwards.mcap").attachments[SESSION_ATTACHMENT]
    assert read_stored(LabSession, content).id == session["id"]
    [found] = service.http.get("/api/runs", params={"session": session["id"]}).json()
    assert (found["id"], found["session"]) == ("afterwards", session["id"])
