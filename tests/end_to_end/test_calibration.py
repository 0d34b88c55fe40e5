"""Calibrations over REST, reading by reading, on the simulated tool in real time; the files they leave."""

import threading
import tomllib
from datetime import date, timedelta
from pathlib import Path

import pytest
from service import Service, until

from config.load import CONFIG_DIR, load_tool
from config.schema import ConstantMeasurement
from config.writing import write_calibrated_tool

CALIBRATION = load_tool("simulated").calibration


@pytest.fixture(scope="module")
def service():
    with Service("serve", "--tissue", "liver") as running:
        yield running


def begin(service: Service, what: str, *values: float) -> dict:
    answer = service.http.post("/api/calibration", json={"what": what, "values": values, "person": "a test"})
    assert answer.status_code == 201, answer.text
    return answer.json()


def read(service: Service):
    return service.http.post("/api/calibration/reading", timeout=60.0)


def calibrate(service: Service, what: str, *values: float) -> dict:
    state = begin(service, what, *values)
    for _ in state["values"]:
        answer = read(service)
        assert answer.status_code == 200, answer.text
        state = answer.json()
    return state["result"]


@pytest.mark.long
def test_one_calibration_builds_on_the_other_and_tissue_is_held_again(service: Service) -> None:
    for what, values, truth in (
        ("stretch", (), {"calibration.encoder_deg_per_volt": CALIBRATION.encoder_deg_per_volt}),
        ("strain", (0, 5, 10, 15), {"calibration.newton_per_volt": CALIBRATION.newton_per_volt}),
        ("geometry", (0, 3, 6), {"calibration.handle_per_encoder": CALIBRATION.handle_per_encoder}),
    ):
        result = calibrate(service, what, *values)
        found = {each["key"]: each for each in result["constants"]}
        for key, value in truth.items():
            assert found[key]["value"] == pytest.approx(value, rel=0.01)
            assert found[key]["low"] < found[key]["value"] < found[key]["high"]
        assert len(result["x"]) == len(result["y"])
    file = Path(result["file"])
    assert file.parent == service.data / "tools"
    measured = {each["constant"] for each in tomllib.loads(file.read_text())["calibration"]["measured"]}
    assert measured == {"newton_per_volt", "encoder_deg_per_volt", "handle_per_encoder", "opening_m"}
    run = service.run(protocol="trapezoid_2hz", cycles=1)
    service.finished(run["id"])
    assert service.http.get(f"/api/runs/{run['id']}/grasps").json()[0]["label"] == "liver"


def test_a_measured_force_scale_is_in_the_new_tool_file_with_its_interval_and_expiry(service: Service) -> None:
    result = calibrate(service, "force", 0, 1, 2, 3, 4)
    scale = load_tool(result["file"]).calibration.jaw_force_scale
    assert scale.measured
    assert scale.low < CALIBRATION.jaw_force_scale.value < scale.high
    assert (scale.date, scale.expires) == (date.today(), date.today() + timedelta(days=90))
    assert "a test" in scale.source
    kept = service.http.delete(f"/api/configuration/tool/{Path(result['file']).stem}")
    assert (kept.status_code, "The next calibration builds on this" in kept.json()["detail"]) == (409, True)
    assert Path(result["file"]).is_file()


def test_a_stop_ends_a_reading_that_moves_and_it_may_be_repeated(service: Service) -> None:
    begin(service, "stretch")
    answers = []
    reading = threading.Thread(target=lambda: answers.append(read(service)))
    reading.start()
    until(lambda: service.http.get("/api/calibration").json()["reading"])
    until(lambda: any(run["state"] == "running" for run in service.http.get("/api/runs").json()))
    assert read(service).status_code == 409  # one at a time
    assert service.http.delete("/api/calibration").status_code == 409
    service.http.post("/api/stop")
    reading.join()
    assert answers[0].status_code == 409
    assert "The run was stopped" in answers[0].json()["detail"]
    assert "The run was stopped" in service.http.get("/api/calibration").json()["problem"]
    assert service.http.delete("/api/calibration").json()["what"] is None


@pytest.mark.parametrize(
    ("asked", "status", "says"),
    [
        ({"what": "strain", "values": [0, 2, 4]}, 422, "3 different pulls"),
        ({"what": "geometry", "values": [0, 2]}, 422, "At least 3 gauges"),
        ({"what": "force", "values": [1, 2, 3, 4, 5]}, 422, "the first one 0"),
        ({"what": "strain", "values": [0, -2, 4, 6]}, 422, "greater than or equal to 0"),
        ({"what": "weight"}, 422, "what"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_read(
    service: Service, asked: dict, status: int, says: str
) -> None:
    answer = service.http.post("/api/calibration", json=asked)
    assert answer.status_code == status
    assert says in answer.text
    assert read(service).status_code == 409


def test_nothing_is_read_while_a_run_is_under_way(service: Service) -> None:
    begin(service, "tare")
    service.run(protocol="trapezoid_025hz", cycles=5)
    answer = read(service)
    service.http.post("/api/stop")
    assert answer.status_code == 409
    assert "A run is under way" in answer.json()["detail"]


def test_each_expired_constant_is_told_by_name(tmp_path: Path) -> None:
    """A tare of today leaves the others expired."""
    text = (CONFIG_DIR / "tools/simulated.toml").read_text()
    old = tmp_path / "old.toml"
    old.write_text(text.replace('person = "simulation"', 'person = "simulation"\nexpires = 2026-11-27', 1))
    tared = ConstantMeasurement(
        constant="rest_offset_v",
        value=0.82,
        low=0.81,
        high=0.83,
        unit="V",
        residual=0.002,
        residual_unit="V",
        readings=10_000,
        date=date.today(),
        person="a test",
        expires=date.today() + timedelta(days=90),
    )
    old = write_calibrated_tool(str(old), {"calibration.rest_offset_v": 0.82}, [tared], date.today(), tmp_path)
    expired = ("newton_per_volt", "encoder_deg_per_volt", "handle_per_encoder", "opening_m", "strain_sd_v")
    names = ", ".join(f"{name} (2026-11-27)" for name in expired)
    with Service("serve", "--tool", str(old)) as running:
        alarms = until(lambda: running.http.get("/api/alarms").json())
        assert [(each["priority"], each["text"]) for each in alarms] == [
            ("low", f"The tool's calibration is expired: {names}. Measure anew before you trust forces")
        ]
        system = running.http.get("/api/system").json()
        assert {each["constant"]: each["expired"] for each in system["constants"]} == {
            **dict.fromkeys(expired, True),
            "rest_offset_v": False,
            "jaw_force_scale": False,
        }
        realtime = system["realtime"]
        assert set(realtime) == {"acquisition", "estimator", "recorder", "server"}
        assert all(each.startswith("priority ") for each in realtime.values())
