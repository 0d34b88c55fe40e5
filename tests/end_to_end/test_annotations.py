"""Ground truth of grasps and marks: stated during a run, recorded, corrected, found again; never seen by estimators."""

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from service import PROGRAM, Listener, Service, until

from acquisition.recordings.mcap_reader import McapFile


@pytest.fixture(scope="module")
def service() -> Iterator[Service]:
    with Service("serve", "--tissue", "liver") as running:
        yield running


def state(service: Service, **truth: object) -> dict:
    answer = service.http.post("/api/truth", json={"by": "Ada", **truth})
    assert answer.status_code == 200, answer.text
    return answer.json()


def truths(service: Service, run_id: str) -> list[tuple]:
    told = service.http.get(f"/api/runs/{run_id}/truth").json()
    return [(each["grasp"], each["held"], each["remark"], each["version"]) for each in told]


def recorded_json(path: Path, topic: str) -> list[tuple[str, dict]]:
    with path.open("rb") as file:
        return [
            (schema.name, json.loads(message.data)) for schema, _, message in make_reader(file).iter_messages(topic)
        ]


def test_what_is_stated_before_and_during_grasps_is_recorded_with_them(service: Service) -> None:
    before = {"held": "liver", "remark": None, "place": "left lobe", "by": "Ada"}
    assert state(service, held="liver", place="left lobe") == before  # before the run
    with Listener(service) as viewer:
        run = service.run(protocol="trapezoid_2hz", cycles=4)
        viewer.listen(lambda: len(viewer.of("grasp")) == 1)
        state(service, held="spleen", remark="slipped")  # for the second grasp; no library knows a spleen
        viewer.listen(lambda: len(viewer.of("grasp")) == 2)
        viewer.listen(lambda: any(m["in_contact"] and m["grasp"] == 3 for m in viewer.of("identification")))
        assert service.http.post("/api/spots", json={}).status_code == 200
        viewer.listen(lambda: len(viewer.of("grasp")) == 4)
        said = [(each["grasp"], each["held"], each["remark"]) for each in viewer.of("truth")]
        assert said == [(1, "liver", None), (2, "spleen", "slipped"), (3, "spleen", None)]
        assert viewer.of("truth")[0]["number"] == viewer.of("grasp")[0]["number"] + 1
    run = service.finished(run["id"])
    assert truths(service, run["id"]) == [(1, "liver", None, 1), (2, "spleen", "slipped", 1), (3, "spleen", None, 1)]
    lines = [line for _, line in recorded_json(service.recorded(run["id"]), "/journal") if line["kind"] == "truth"]
    assert [line["truth"]["held"] for line in lines] == ["liver", "spleen", "spleen"]
    assert [line["truth"].get("place") for line in lines] == ["left lobe", None, None]
    assert state_now(service) == {
        "held": None,
        "remark": None,
        "place": None,
        "by": None,
    }  # the next run is another one


def state_now(service: Service) -> dict:
    with Listener(service) as viewer:
        viewer.listen(lambda: viewer.of("state"))
        return viewer.of("state")[-1]["stated"]


def test_a_grasp_that_stop_interrupts_keeps_its_statement(service: Service) -> None:
    with Listener(service) as viewer:
        run = service.run(protocol="trapezoid_2hz", cycles=4)
        state(service, held="gallbladder")
        viewer.listen(lambda: any(m["in_contact"] for m in viewer.of("identification")))
        service.http.post("/api/stop")
        viewer.listen(lambda: any(truth["run_id"] == run["id"] for truth in viewer.of("truth")))
    assert truths(service, run["id"]) == [(1, "gallbladder", None, 1)]


def test_a_truth_is_corrected_with_a_reason_and_the_later_of_two_is_told(service: Service) -> None:
    run = service.finished(service.run(protocol="trapezoid_2hz", cycles=2)["id"])
    until(lambda: len(service.http.get(f"/api/runs/{run['id']}/grasps").json()) == 2)
    path = f"/api/runs/{run['id']}/grasps/2/truth"

    def correct(**body: object) -> tuple[int, dict]:
        answer = service.http.put(path, json={"held": "liver", "by": "Ada", **body})
        return answer.status_code, answer.json()

    status, first = correct(version=0)
    assert (status, first["version"], first["why"]) == (200, 1, None)
    status, problem = correct(version=0, held="bladder", by="Grace")
    assert (status, problem["detail"]) == (
        409,
        "Ada has changed this meanwhile: it is at version 1. Look at it, then try again.",
    )
    status, problem = correct(version=1, held="bladder")
    assert (status, problem["errors"][0]["field"]) == (422, "why")
    status, second = correct(version=1, held="bladder", remark="two tissues", why="seen on the video", by="Grace")
    assert (status, second["version"], second["held"]) == (200, 2, "bladder")
    assert truths(service, run["id"]) == [(2, "bladder", "two tissues", 2)]
    lines = service.http.get("/api/audit", params={"kind": "truth", "limit": 2}).json()
    assert [(line["by"], line["truth"]["why"]) for line in lines] == [("Grace", "seen on the video"), ("Ada", None)]

    assert (
        service.http.put(path.replace("grasps/2", "grasps/3"), json={"held": "liver", "version": 0}).status_code == 404
    )
    assert service.http.put(path.replace(run["id"], "none"), json={"held": "liver", "version": 0}).status_code == 404
    assert "small letters" in correct(version=2, held="Liver!", why="a slip")[1]["detail"]


def test_a_mark_lies_at_the_sample_that_the_person_saw(service: Service) -> None:
    assert service.http.post("/api/marks", json={"text": "too early"}).status_code == 409
    with Listener(service) as viewer:
        run = service.run(protocol="trapezoid_2hz", cycles=3)
        viewer.listen(lambda: viewer.frames and any(each["run_id"] == run["id"] for each in viewer.of("grasp")))
        header, columns = viewer.frames[-1]
        seen = header[6] + columns.shape[1] - 1
        mark = service.http.post("/api/marks", json={"text": "smoke", "tick": seen, "by": "Ada"}).json()
        assert mark["at_s"] == pytest.approx(seen / 1000.0)
        assert 0.0 <= mark["uncertainty_s"] < 2.0
        assert service.http.post("/api/marks", json={"text": "x", "tick": seen + 10**6}).status_code == 422
        viewer.listen(lambda: viewer.of("mark"))
        assert viewer.of("mark")[0]["text"] == "smoke"
        other = service.http.post("/api/marks", json={"text": "irrigation", "by": "Ada"}).json()
        assert other["at_s"] > mark["at_s"]
    service.finished(run["id"])
    changed = service.http.put(f"/api/marks/{mark['id']}", json={"text": "smoke in view", "version": 1, "by": "Ada"})
    assert changed.json()["version"] == 2
    assert service.http.put(f"/api/marks/{mark['id']}", json={"text": "late", "version": 1}).status_code == 409
    assert service.http.delete(f"/api/marks/{other['id']}", params={"version": 1}).json()["deleted"]
    assert service.http.delete(f"/api/marks/{other['id']}", params={"version": 2}).status_code == 404
    left = service.http.get(f"/api/runs/{run['id']}/marks").json()
    assert [(each["id"], each["text"]) for each in left] == [(mark["id"], "smoke in view")]

    events = recorded_json(service.recorded(run["id"]), "/mark")
    assert [name for name, _ in events] == ["foxglove.Event"] * 2
    [_, first], _ = events
    at_s = first["start_time"]["sec"] + first["start_time"]["nsec"] / 1e9
    assert at_s == pytest.approx(mark["at_ms"] / 1e3, abs=1e-3)
    assert {"key": "text", "value": "smoke"} in first["metadata"]

    path = service.recorded(run["id"])
    with Listener(service, f"/api/recordings/{path.name}/replay") as replay:
        replay.listen(lambda: any(each["prepared"] == 1.0 for each in replay.of("replay_state")), 60.0)
        begins_s = replay.of("replay_state")[-1]["start_s"]
    first_tick = int(McapFile(path).metadata["first_tick"])
    assert begins_s == pytest.approx(first_tick / 1000.0, abs=0.005)  # so that the page can jump to the mark


def test_statements_outlive_a_rebuild_of_the_index() -> None:
    with Service("serve", "--tissue", "liver") as service:
        state(service, held="liver")
        run = service.finished(service.run(protocol="trapezoid_2hz", cycles=1)["id"])
        until(lambda: truths(service, run["id"]))
        wanted = {"held": "bladder", "version": 1, "why": "seen on the video"}
        assert service.http.put(f"/api/runs/{run['id']}/grasps/1/truth", json=wanted).status_code == 200
        service.recorded(run["id"])
        service.end()
        subprocess.run([PROGRAM, "index", "--rebuild", "--data", service.data], check=True, capture_output=True)
        with Service("serve", data=service.data) as again:
            assert truths(again, run["id"]) == [(1, "bladder", None, 2)]
