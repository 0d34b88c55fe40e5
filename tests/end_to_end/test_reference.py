"""A reference grasp on the service: taken, kept, used by later runs, and declined."""

import json

import pytest
from service import Listener, Service, until

from acquisition.recordings.mcap_layout import REFERENCE_ATTACHMENT
from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import RecordingSource
from config.load import load_tool
from config.schema import ReferenceGrasp


@pytest.fixture(scope="module")
def service():
    with Service("serve", "--tissue", "liver") as running:
        yield running


def run(service: Service, protocol: str, cycles: int) -> dict:
    """Play a run to its end, and wait until its recording is complete."""
    begun = service.run(protocol=protocol, cycles=cycles, by="Ada")
    ended = service.finished(begun["id"])
    service.recorded(begun["id"])
    return ended


def state(service: Service) -> dict:
    with Listener(service) as viewer:
        viewer.listen(lambda: viewer.of("state"))
        return viewer.of("state")[-1]["reference"]


def test_a_reference_grasp_is_taken_kept_and_recorded_with_the_runs_that_follow(service: Service) -> None:
    assert state(service) == {"taken_at": None, "stall_v": None, "declined": False, "wanted": False, "problem": None}
    answer = service.http.post("/api/runs", json={"protocol": "reference_grasp", "tissue": "liver"})
    assert answer.status_code == 422
    assert answer.json()["detail"] == "A reference grasp closes on nothing. Leave `tissue` out."
    before = run(service, "trapezoid_2hz", 1)
    assert before["grasps"] == 1

    taken = run(service, "reference_grasp", 3)
    assert taken["id"].startswith("reference-")
    assert (taken["grasps"], taken["tissue"]) == (0, None)  # nothing is named in it
    found = until(lambda: now if (now := state(service))["taken_at"] or now["problem"] else None, 60.0)
    assert found["problem"] is None
    kept = ReferenceGrasp.model_validate_json((service.data / "references" / "simulated.json").read_bytes())
    assert kept.stall_v == state(service)["stall_v"]
    assert (kept.tool, kept.person, kept.grasps) == ("simulated", "Ada", 3)
    stretch = load_tool("simulated").calibration.encoder_deg_per_volt
    assert kept.stretch_deg_per_volt == pytest.approx(stretch, rel=0.1)  # its strain is as small as its noise is large
    journal = [json.loads(line)["text"] for line in (service.data / "journal.jsonl").read_text().splitlines()]
    assert f"Reference grasp taken: {kept}" in journal

    after = run(service, "trapezoid_2hz", 1)
    assert (after["grasps"], after["tissue"]) == (1, "liver")  # the jaws hold tissue again
    files = [service.data / "recordings" / f"{each['id']}.mcap" for each in (before, taken, after)]
    assert [REFERENCE_ATTACHMENT in McapFile(path).attachments for path in files] == [False, False, True]
    recordings = [RecordingSource(path, load_tool("simulated")) for path in files]
    assert recordings[2].conditions.reference == kept
    assert [each.is_reference_grasp for each in recordings] == [False, True, False]


def test_a_day_may_go_on_without_and_a_run_that_was_cut_short_is_no_reference(service: Service) -> None:
    answer = service.http.post("/api/reference/decline", json={"by": "Ada"})
    assert answer.json()["declined"]
    assert state(service)["declined"]
    begun = service.http.post("/api/runs", json={"protocol": "reference_grasp"}).json()
    service.http.post("/api/stop")
    until(lambda: service.http.get(f"/api/runs/{begun['id']}").json()["state"] == "stopped")
    assert "The reference grasp was stopped" in until(lambda: state(service)["problem"])
