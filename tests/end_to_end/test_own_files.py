"""Own protocols, libraries and tool files of a running service, over REST, and a new calibration without a restart."""

from collections.abc import Iterator
from datetime import date, timedelta
from pathlib import Path

import httpx
import pytest
from closings_table import CLOSINGS, write_closings_table
from service import Listener, Service, until

from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import read_recorded_tool
from config.load import CONFIG_DIR
from config.schema import ConstantMeasurement
from config.writing import write_calibrated_tool

PATH = "/api/configuration"
HOLD = """name = "hold"
title = "Hold gently"

[waveform]
shape = "trapezoid"
peak_v = 0.5
ramp_up_s = 0.1
hold_s = 5.0
ramp_down_s = 0.1
rest_s = 0.2
"""


@pytest.fixture(scope="module")
def service() -> Iterator[Service]:
    with Service("serve", "--tissue", "liver") as running:
        for folder in ("protocols", "tissues", "tools"):
            (running.data / folder).mkdir(exist_ok=True)
        yield running


def save(service: Service, kind: str, text: str, replaces: str | None = None) -> httpx.Response:
    return service.http.post(f"{PATH}/{kind}", json={"text": text, "replaces": replaces, "by": "a test"})


def files(service: Service, kind: str) -> dict[str, dict]:
    listed = service.http.get(PATH).json()["files"]
    return {each["name"]: each for each in listed if each["kind"] == kind and not each["shipped"]}


def playable(service: Service) -> set[str]:
    return {each["name"] for each in service.http.get("/api/protocols").json()}


def test_a_tool_file_is_drafted_from_a_recording(service: Service, tmp_path: Path) -> None:
    content = write_closings_table(tmp_path / "mine.csv").read_bytes()
    binary = {"content-type": "application/octet-stream"}

    def draft(**answers: object) -> httpx.Response:
        query = {"file": "mine.csv", "name": "mine"} | answers
        return service.http.post(f"{PATH}/tool/draft", params=query, content=content, headers=binary, timeout=60.0)

    seen = draft().json()
    assert [(each["number"], each["name"]) for each in seen["columns"]] == [
        (1, "clock (ms)"),
        (3, "opening"),
        (4, "force"),
        (5, "unused"),
    ]
    assert seen["columns"][2]["high"] == pytest.approx(300.0, abs=3.0)
    assert seen["times"] == {"column": 1, "unit": "ms", "rate_hz": pytest.approx(500.0)}
    assert (seen["text"], seen["first_grasps"]) == (None, [])

    drafted = draft(force=4, position=3, newton=0.01, port="/dev/ttyACM7").json()
    assert drafted["grasps"] == CLOSINGS
    assert [each["peak_force_n"] for each in drafted["first_grasps"]] == pytest.approx([3.0] * 5, abs=0.05)
    assert drafted["assumed"] == ["millimetres"]
    saved = save(service, "tool", drafted["text"])
    assert saved.status_code == 201, saved.text
    assert files(service, "tool")["mine"]["problems"] == []

    for answers, told in (
        ({"force": 2, "position": 3}, "column 2 holds no numbers; there is 1, 3, 4, 5"),
        ({"force": 4, "position": 3, "command": 1, "port": "/dev/ttyACM7"}, "has no motor command"),
        ({"file": "mine.parquet"}, "mine.parquet"),
    ):
        refused = draft(**answers)
        assert refused.status_code == 422
        assert told in refused.json()["detail"]
    assert draft(file="").status_code == 422


def test_a_recording_that_is_too_large_is_refused_before_it_is_read(service: Service) -> None:
    too_large = service.http.post(f"{PATH}/tool/draft?file=a.txt", content=b"1 2\n" * (17 * 2**20), timeout=60.0)
    assert too_large.status_code == 413
    assert service.http.post(f"{PATH}/tool", content=b"1 2\n" * 2**20).status_code == 413


def test_an_own_protocol_is_saved_played_kept_during_its_run_changed_and_deleted(service: Service) -> None:
    saved = save(service, "protocol", HOLD)
    assert (saved.status_code, saved.json()["name"]) == (201, "hold"), saved.text
    assert max(saved.json()["protocol"]["command_v"]) == pytest.approx(0.5)
    assert "hold" in playable(service)
    version, path = saved.json()["version"], f"{PATH}/protocol/hold"
    run = service.run(protocol="hold", cycles=1)
    for refused in (save(service, "protocol", HOLD.replace("5.0", "1.0"), version), service.http.delete(path)):
        assert refused.status_code == 409
        assert f"The run {run['id']} plays this protocol" in refused.json()["detail"]
    assert files(service, "protocol")["hold"]["in_use"]
    service.http.post("/api/stop")
    assert save(service, "protocol", HOLD).status_code == 409  # it exists, and the request names no version of it
    changed = save(service, "protocol", HOLD.replace("5.0", "1.0"), version)
    assert (changed.status_code, changed.json()["protocol"]["cycle_s"]) == (201, pytest.approx(1.4))
    assert save(service, "protocol", HOLD.replace("5.0", "2.0"), version).status_code == 409  # changed meanwhile
    assert (service.data / "protocols/hold.toml").read_text() == HOLD.replace("5.0", "1.0")
    assert service.http.delete(path).status_code == 200
    assert "hold" not in playable(service)
    assert service.http.delete(path).status_code == 404
    lines = [each for each in service.http.get("/api/journal").json() if "protocol hold" in each["text"]]
    assert {each["by"] for each in lines if "Save" in each["text"]} == {"a test"}
    assert any(f"instead of {version}" in each["text"] for each in lines)


def test_what_has_faults_is_refused_with_one_message_each_and_shipped_files_stay(service: Service) -> None:
    wrong = HOLD.replace("peak_v = 0.5", "peek_v = 0.5").replace('"hold"', '"../hold"')
    problem = save(service, "protocol", wrong).json()
    assert (problem["status"], len(problem["errors"])) == (422, 3)
    assert {each["field"] for each in problem["errors"]} == {"text"}
    checked = service.http.post(f"{PATH}/protocol/check", json={"text": wrong}).json()
    assert checked["problems"] == [each["message"] for each in problem["errors"]]
    assert any("did you mean 'peak_v'" in each for each in checked["problems"])
    assert save(service, "protocol", "[[[").status_code == 422
    for kind, folder, name in (
        ("protocol", "protocols", "sine"),
        ("library", "tissues", "porcine"),
        ("tool", "tools", "nidaq"),
    ):
        text = (CONFIG_DIR / folder / f"{name}.toml").read_text()
        refused = save(service, kind, text)
        assert (refused.status_code, "another `name`" in refused.json()["detail"]) == (409, True)
        assert service.http.delete(f"{PATH}/{kind}/{name}").status_code == 409
        assert (CONFIG_DIR / folder / f"{name}.toml").read_text() == text
        assert save(service, kind, text.replace(f'name = "{name}"', 'name = "copied"', 1)).status_code == 201
        assert files(service, kind)["copied"]["problems"] == []
        assert (service.data / folder / "copied.toml").is_file()
    assert not (service.data / "hold.toml").exists()
    assert service.run(protocol="copied", cycles=1)["protocol"] == "copied"
    service.http.post("/api/stop")


def test_a_library_is_approved_changed_and_restored_with_its_approval(service: Service) -> None:
    first = (CONFIG_DIR / "tissues/porcine.toml").read_text().replace('name = "porcine"', 'name = "ward_3"', 1)
    path = f"{PATH}/library/ward_3"
    assert service.http.get(f"{path}/versions").status_code == 404
    version = save(service, "library", first).json()["version"]
    decision = {"version": version, "reason": "judged on 40 spots", "by": "Ada"}
    assert service.http.post(f"{path}/approval", json=decision | {"version": "0" * 16}).status_code == 404
    assert service.http.post(f"{path}/approval", json=decision).status_code == 201
    approval = files(service, "library")["ward_3"]["approval"]
    assert (approval["approved"], approval["by"], approval["reason"]) == (True, "Ada", "judged on 40 spots")
    changed = save(service, "library", first + "# changed\n", version).json()
    assert changed["file"]["approval"] is None
    now, before = service.http.get(f"{path}/versions").json()
    assert (now["version"], now["current"], now["approval"]) == (changed["version"], True, None)
    assert (before["version"], before["current"], before["approval"]["approved"]) == (version, False, True)
    stale = {"version": version, "replaces": version, "by": "Ada"}
    assert service.http.post(f"{path}/restore", json=stale).status_code == 409  # somebody has changed it meanwhile
    restored = service.http.post(f"{path}/restore", json=stale | {"replaces": changed["version"]}).json()
    assert (restored["version"], restored["file"]["approval"]["approved"]) == (version, True)
    assert service.http.delete(path).status_code == 200
    kept = [each["version"] for each in service.http.get(f"{path}/versions").json()]
    assert set(kept) == {version, changed["version"]}
    assert service.http.post(f"{path}/restore", json={"version": version}).status_code == 201
    journal = [line["text"] for line in service.http.get("/api/journal").json()]
    assert any(version in line and "judged on 40 spots" in line for line in journal)


def test_a_faulty_file_in_the_folder_is_listed_with_its_faults_and_stops_nothing(service: Service) -> None:
    folder = service.data / "protocols"
    (folder / "broken.toml").write_bytes(b"\xff\xfe")
    (service.data / "tissues/no_text.toml").write_bytes(b"\xff\xfe")
    assert service.http.delete(f"{PATH}/library/no_text").status_code == 200
    (folder / "sine.toml").write_text(HOLD.replace('"hold"', '"sine"'))
    (folder / "renamed.toml").write_text(HOLD)
    (service.data / "tissues/old.toml").write_text(
        (CONFIG_DIR / "tissues/porcine.toml").read_text().replace('units = "pascal and strain"', "")
    )
    found = files(service, "protocol") | files(service, "library")
    for name, says in {
        "broken": "cannot be read as a text file",
        "sine": "there is a shipped protocol 'sine'",
        "renamed": "Give both the same name",
        "old": "does not say in which units",
    }.items():
        assert says in " ".join(found[name]["problems"]), name
    assert not {"broken", "renamed"} & playable(service)
    (folder / "endless.toml").write_text(HOLD.replace('"hold"', '"endless"').replace("5.0", "3000.0"))
    [endless] = [each for each in service.http.get("/api/protocols").json() if each["name"] == "endless"]
    assert "at 1000 samples a second at most 300 s can be played" in endless["refused"]
    refused = service.http.post("/api/runs", json={"protocol": "endless"})
    assert (refused.status_code, refused.json()["detail"]) == (422, endless["refused"])
    refused = service.http.post("/api/runs", json={"protocol": "renamed"})
    assert (refused.status_code, "Give both the same name" in refused.json()["detail"]) == (422, True)
    assert service.http.post("/api/runs", json={"protocol": str(folder / "renamed.toml")}).status_code == 422
    assert service.http.get(f"{PATH}/protocol/renamed").json()["text"] == HOLD
    assert service.http.delete(f"{PATH}/protocol/broken").status_code == 200
    assert not (folder / "broken.toml").exists()


def test_a_new_calibration_is_used_without_a_restart_and_recordings_carry_it(service: Service) -> None:
    until(lambda: service.http.get("/api/health").json()["detail"] == "idle")
    today = date.today()
    measured = ConstantMeasurement(
        constant="newton_per_volt",
        value=12.5,
        low=12.4,
        high=12.6,
        unit="N/V",
        residual=0.01,
        residual_unit="V",
        readings=6,
        date=today,
        person="a test",
        expires=today + timedelta(days=90),
    )
    path = write_calibrated_tool(
        "simulated", {"calibration.newton_per_volt": 12.5}, [measured], today, service.data / "tools"
    )
    use = f"{PATH}/tool/{path.stem}/use?by=a test"
    run = service.run(protocol="sine", cycles=3)
    assert service.http.post(use).status_code == 409  # a run is under way
    service.http.post("/api/stop")
    other = service.http.post(f"{PATH}/tool/nidaq/use")
    assert (other.status_code, "differs from the tool in use" in other.json()["detail"]) == (409, True)
    assert service.http.post(f"{PATH}/tool/none/use").status_code == 404
    with Listener(service) as viewer:
        before = service.worker("acquisition")
        until(lambda: service.http.post(use).status_code == 200)  # once the last recording is complete
        refused = service.http.post("/api/runs", json={"protocol": "trapezoid_2hz"})
        assert refused.status_code == 503, refused.text
        assert service.http.post("/api/calibration", json={"what": "tare", "person": "a test"}).status_code == 201
        refused = service.http.post("/api/calibration/reading")  # the old workers may still be there
        assert (refused.status_code, "not ready (starting)" in refused.json()["detail"]) == (409, True), refused.text
        viewer.listen(lambda: len(viewer.of("hello")) == 2)
        until(lambda: service.http.get("/api/health").json()["detail"] == "idle", 60.0)
        assert service.worker("acquisition") != before
        viewer.listen(lambda: "starting idle" in " ".join(state["phase"] for state in viewer.of("state")), 30.0)
        assert viewer.of("state")[-1]["safety"] == "disarmed"
        assert [alarm["text"] for alarm in viewer.of("alarm") if alarm["priority"] != "low"] == []
    system = service.http.get("/api/system").json()
    assert system["tool"]["calibration"]["newton_per_volt"] == 12.5
    run = service.finished(service.run(protocol="trapezoid_4hz", cycles=1)["id"])
    assert run["state"] == "finished", run
    recording = service.data / "recordings" / f"{run['id']}.mcap"
    until(lambda: recording.is_file() and McapFile(recording).complete)
    assert read_recorded_tool(McapFile(recording)).calibration.newton_per_volt == 12.5
    assert files(service, "tool")[path.stem]["in_use"]
    assert service.http.delete(f"{PATH}/tool/{path.stem}").status_code == 409
    assert any("is used from now on" in each["text"] for each in service.http.get("/api/journal").json())
