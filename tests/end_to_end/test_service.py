"""The whole way, volts to wire, on real processes and sockets."""

import os
import re
import signal
import socket
import time
from concurrent.futures import ThreadPoolExecutor

import httpx
import numpy as np
import pytest
from sabotage import SABOTEUR, SIGNALS
from service import Listener, Service, until
from websockets.sync.client import connect

from config.load import CONFIG_DIR


@pytest.fixture(scope="module")
def service():
    with Service("serve") as running:
        yield running


def column(listener, name, tissue=None):
    names = [(c["name"], c["tissue"]) for c in listener.of("hello")[0]["channels"]]
    return names.index((name, tissue))


@pytest.mark.parametrize("tissue", ["bladder", "gallbladder"])
def test_a_grasp_goes_in_and_a_label_comes_out(service, tissue):
    with Listener(service) as listener:
        run = service.run(protocol="trapezoid_2hz", cycles=2, tissue=tissue)
        listener.listen(lambda: len(listener.of("grasp")) >= 2 and listener.of("grasp")[-1]["run_id"] == run["id"])
        live = [m["label"] for m in listener.of("identification") if m["in_grasp"] and m["in_contact"]]
        assert tissue in live
        held = np.concatenate([c[column(listener, "alpha_n", tissue)] for h, c in listener.frames if h[1] == 0])
        assert np.isfinite(held).any()
    over = service.finished(run["id"])
    grasps = service.http.get(f"/api/runs/{run['id']}/grasps").json()
    assert (over["state"], over["grasps"]) == ("finished", 2)
    assert [grasp["label"] for grasp in grasps] == [tissue, tissue]
    assert [grasp["index"] for grasp in grasps] == [1, 2]
    assert all(grasp["peak_force_n"] == pytest.approx(1.55, rel=0.05) for grasp in grasps)


@pytest.mark.long
def test_a_withdrawn_name_is_told_and_the_lowest_limit_holds_again(tmp_path):
    """Liver and small bowel overlap: who names them too early, at 60 %, has to withdraw in every third grasp or so."""
    rash = (CONFIG_DIR / "graspwatch.toml").read_text()
    changes = ("decide_at = 0.95", 0.6), ("withdraw_below = 0.85", 0.59), ("confirm_s = 0.03", 0.005)
    for line, value in changes:
        assert line in rash
        rash = rash.replace(line, f"{line.split(' = ')[0]} = {value}")
    (tmp_path / "rash.toml").write_text(rash)

    def withdrawn(listener):
        return [
            m for m in listener.of("event") if re.fullmatch(r"(Liver|Small bowel) withdrawn: \d\d? % now", m["text"])
        ]

    with Service("serve", "--config", str(tmp_path / "rash.toml")) as running, Listener(running) as listener:
        running.run(protocol="trapezoid_4hz", cycles=60, tissue="liver")
        listener.listen(lambda: withdrawn(listener), timeout_s=65.0)
        [event] = withdrawn(listener)
        name = event["text"].split(" withdrawn")[0].lower().replace(" ", "_")
        lowest_n = listener.of("hello")[0]["lowest_threshold_n"]
        told = listener.messages[: listener.messages.index(event)]
        *before, now = [m for m in told if m["type"] == "identification" and m["in_grasp"]]
        assert before[-1]["label"] == name
        assert (now["label"], now["threshold_n"], now["threshold_tissue"]) == ("undecided", lowest_n, None)
        assert f"{100 * now['probabilities'][name]:.0f} % now" in event["text"]


def test_the_stream_is_gapless_at_1_khz(service):
    with Listener(service) as listener:
        listener.listen(lambda: len([h for h, _ in listener.frames if h[1] == 0]) > 40)
        live = [(int(h[6]), c.shape[1]) for h, c in listener.frames if h[1] == 0]
        ends = [tick + rows for tick, rows in live]
        assert [tick for tick, _ in live[1:]] == ends[:-1]
        thresholds = np.concatenate([c[column(listener, "threshold_n")] for h, c in listener.frames if h[1] == 0])
        assert np.isfinite(thresholds).all()  # every sample came with its estimates
        hello = listener.of("hello")[0]
        assert hello["tool"]["kind"] == "simulated"
        assert [t["name"] for t in hello["library"]["tissues"]] == ["liver", "small_bowel", "bladder", "gallbladder"]
        assert len(hello["channels"]) == listener.frames[0][1].shape[0]


def test_who_comes_later_sees_the_last_seconds(service):
    time.sleep(1.0)
    with Listener(service) as listener:
        listener.listen(lambda: len([h for h, _ in listener.frames if h[1] == 0]) > 1)
        history = [(h, c) for h, c in listener.frames if h[1] == 1]
        assert history[0][1].shape[1] > 500
        assert history[-1][0][6] + history[-1][1].shape[1] == listener.frames[len(history)][0][6]


def test_a_viewer_that_does_not_answer_gets_no_more_than_a_window_of_frames_but_every_message(service):
    with Listener(service) as listener:
        listener.listen(lambda: len(listener.of("state")) >= 4, answer=False)
        assert len(listener.frames) <= 8


def test_two_runs_at_once_are_refused_and_stop_always_works(service):
    run = service.run(protocol="trapezoid_025hz", cycles=5, tissue="liver")
    second = service.http.post("/api/runs", json={"protocol": "sine"})
    assert second.status_code == 409
    assert second.headers["content-type"] == "application/problem+json"
    assert run["id"] in second.json()["detail"]
    time.sleep(1.2)
    stopped = service.http.post("/api/stop").json()
    assert stopped["stopped"] is True
    assert stopped["run"]["state"] == "stopped"
    again = service.http.post("/api/stop")
    assert (again.status_code, again.json()["stopped"]) == (200, False)
    with Listener(service) as listener:
        listener.listen(lambda: len([h for h, _ in listener.frames if h[1] == 0]) > 5)
        command = np.concatenate([c[column(listener, "motor_command_v")] for h, c in listener.frames if h[1] == 0])
        stopped_at = np.flatnonzero(command == 0.0)[0]  # the first frame may hold samples from before the stop
        assert stopped_at < len(command) / 2
        assert not command[stopped_at:].any()


def test_stopping_a_run_by_its_name_twice_changes_nothing_the_second_time(service):
    run = service.run(protocol="trapezoid_2hz", cycles=50, tissue="liver")
    first = service.http.post(f"/api/runs/{run['id']}/stop").json()
    second = service.http.post(f"/api/runs/{run['id']}/stop").json()
    assert (first["stopped"], second["stopped"]) == (True, False)
    assert second["run"]["state"] == "stopped"


@pytest.mark.parametrize(
    ("body", "field", "says"),
    [
        ({"protocol": "nonsense"}, "protocol", "trapezoid_2hz"),
        ({"protocol": "sine", "tissue": "livr"}, "tissue", "'liver'"),
        ({"protocol": "sine", "cycles": 0}, "cycles", "greater than or equal to 1"),
        ({"protocol": "trapezoid_025hz", "cycles": 9000}, "cycles", "3600 s"),
        ({"protokol": "sine"}, "protokol", "not permitted"),
        ({}, "protocol", "required"),
    ],
)
def test_a_wrong_request_names_its_field(service, body, field, says):
    response = service.http.post("/api/runs", json=body)
    assert response.status_code == 422
    assert response.headers["content-type"] == "application/problem+json"
    faults = {fault["field"]: fault["message"] for fault in response.json()["errors"]}
    assert says in faults[field]


def test_unknown_things_are_problems_too(service):
    for path in ("/api/runs/nope", "/api/runs/nope/grasps", "/api/nope"):
        response = service.http.get(path)
        assert (response.status_code, response.headers["content-type"]) == (404, "application/problem+json")


def test_the_catalogue_and_the_metrics_answer(service):
    protocols = {p["name"]: p for p in service.http.get("/api/protocols").json()}
    assert protocols["trapezoid_2hz"]["peak_command_v"] == 2.0
    assert protocols["trapezoid_4hz_low"]["peak_command_v"] == 0.5
    thresholds = {t["name"]: t["threshold_n"] for t in service.http.get("/api/tissues").json()["tissues"]}
    assert thresholds == pytest.approx(
        {"liver": 3.38, "small_bowel": 5.63, "bladder": 2.25, "gallbladder": 2.25}, abs=0.01
    )
    metrics = service.http.get("/metrics").text
    assert "graspwatch_samples_total" in metrics
    assert "graspwatch_lost_samples_total 0.0" in metrics


def test_the_dashboard_and_its_documentation_come_from_this_server_alone(service):
    page = service.http.get("/")
    assert "default-src 'self'" in page.headers["content-security-policy"]
    for path in ("/", "/docs"):
        assert "//cdn" not in service.http.get(path).text
    assert service.http.get("/openapi.json").json()["paths"]["/api/runs"]["post"]["responses"]["409"]


def test_a_message_that_is_none_ends_only_that_viewer(service):
    with Listener(service) as good, connect(service.live_url, max_size=None) as bad:
        bad.send("nonsense")
        with pytest.raises(Exception, match="1007"):
            while True:
                bad.recv(timeout=5)
        good.listen(lambda: len(good.frames) > 3)


def test_sigterm_ends_it_in_order_and_leaves_nothing_behind():
    with Service("serve") as running:
        workers = [running.worker("acquisition"), running.worker("estimator")]
        running.run(protocol="trapezoid_2hz", cycles=50)
        assert running.end() in (0, -signal.SIGTERM, 128 + signal.SIGTERM)
        for pid in workers:
            assert not os.path.exists(f"/proc/{pid}")
        assert "Traceback" not in running.process.stderr.read()


@pytest.mark.long
@pytest.mark.parametrize("worker", ["estimator", "acquisition"])
def test_a_killed_worker_is_told_and_replaced(worker):
    with Service("serve") as running, Listener(running) as listener:
        run = running.run(protocol="trapezoid_025hz", cycles=20, tissue="bladder")
        listener.listen(lambda: any(m["in_grasp"] for m in listener.of("identification")))
        os.kill(running.worker(worker), signal.SIGKILL)
        told_s = listener.listen(lambda: any(worker in a["text"] for a in listener.of("alarm")))
        assert told_s < 0.5
        until(running.ready)
        if worker == "acquisition":
            assert running.finished(run["id"])["state"] == "failed"
            refused = running.http.post("/api/runs", json={"protocol": "trapezoid_2hz"})
            assert (refused.status_code, refused.json()["title"]) == (409, "Conflict")
            assert "A fault is latched: the acquisition worker died. Acknowledge" in refused.json()["detail"]
            assert running.http.post("/api/arm").status_code == 409
            assert "the acquisition worker died" in running.acknowledge_fault()
        else:
            assert running.http.get(f"/api/runs/{run['id']}").json()["state"] == "running"
            running.http.post("/api/stop")
        again = running.run(protocol="trapezoid_2hz", cycles=1, tissue="bladder")
        running.finished(again["id"])
        assert running.http.get(f"/api/runs/{again['id']}/grasps").json()[0]["label"] == "bladder"


@pytest.mark.long
def test_a_worker_that_keeps_dying_is_given_up_after_three_restarts():
    with Service("serve") as running:
        for _ in range(4):
            before = running.worker("estimator")
            os.kill(before, signal.SIGKILL)
            until(lambda: not os.path.exists(f"/proc/{before}"))  # noqa: B023
            faulted = until(
                lambda: running.ready() or running.http.get("/api/health").json()["status"] == "faulted", 30
            )
            assert faulted
        health = running.http.get("/api/health")
        assert (health.status_code, health.json()["status"]) == (503, "faulted")
        assert "estimator" in health.json()["detail"]
        assert running.http.post("/api/stop").status_code == 200


@pytest.mark.long
def test_a_grasp_cut_short_by_stop_is_kept_and_starting_at_once_again_works(service):
    for _ in range(8):
        run = service.run(protocol="trapezoid_025hz", cycles=3, tissue="bladder")
        until(lambda: "running" in service.http.get("/api/health").json()["detail"])
        time.sleep(1.1)
        service.http.post("/api/stop")
        again = service.run(protocol="trapezoid_4hz", cycles=1, tissue="bladder")
        assert service.finished(again["id"])["state"] == "finished"
        grasps = {name: service.http.get(f"/api/runs/{name}/grasps").json() for name in (run["id"], again["id"])}
        assert [len(found) for found in grasps.values()] == [1, 1]
        assert grasps[run["id"]][0]["end_s"] < grasps[again["id"]][0]["start_s"]


@pytest.mark.long
def test_the_demonstration_ends_when_somebody_stops_it():
    with Service("serve", "--demo") as running:
        until(lambda: running.http.get("/api/runs").json())
        running.http.post("/api/stop")
        runs = len(running.http.get("/api/runs").json())
        time.sleep(4.0)
        assert len(running.http.get("/api/runs").json()) == runs
        assert running.http.get("/api/health").json()["detail"] == "idle"


@pytest.mark.long
def test_a_hung_acquisition_is_ended_and_replaced(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(SABOTEUR))
    with Service("serve") as running, Listener(running) as listener:
        run = running.run(protocol="trapezoid_025hz", cycles=20)
        estimator = running.worker("estimator")
        listener.listen(lambda: any(m["in_grasp"] for m in listener.of("identification")))
        os.kill(running.worker("acquisition"), SIGNALS["hangs"])
        told_s = listener.listen(lambda: any("No samples" in a["text"] for a in listener.of("alarm")))
        assert told_s < 0.6
        assert running.finished(run["id"])["state"] == "failed"
        until(running.ready)
        assert running.worker("estimator") == estimator  # which had nothing to answer meanwhile


def test_ctrl_c_in_a_run_ends_everything_without_a_traceback():
    with Service("serve") as running:
        workers = [running.worker("acquisition"), running.worker("estimator")]
        running.run(protocol="trapezoid_2hz", cycles=50)
        time.sleep(1.0)
        for pid in (*workers, running.process.pid):  # a terminal signals the whole group
            os.kill(pid, signal.SIGINT)
        running.process.wait(15)
        assert not [pid for pid in workers if os.path.exists(f"/proc/{pid}")]
        assert "Traceback" not in running.process.stderr.read()


def test_a_tool_is_armed_by_hand_where_the_settings_ask_for_it(tmp_path):
    settings = (CONFIG_DIR / "graspwatch.toml").read_text()
    assert "arm_with_start = true" in settings
    (tmp_path / "by_hand.toml").write_text(settings.replace("arm_with_start = true", "arm_with_start = false"))
    with Service("serve", "--config", str(tmp_path / "by_hand.toml")) as running:
        refused = running.http.post("/api/runs", json={"protocol": "trapezoid_2hz"})
        assert (refused.status_code, "not armed" in refused.json()["detail"]) == (409, True)
        assert running.http.post("/api/arm").json() == {"safety": "armed"}
        run = running.run(protocol="trapezoid_4hz", cycles=1)
        assert running.finished(run["id"])["state"] == "finished"
        running.run(protocol="trapezoid_4hz", cycles=1)  # still armed
        assert running.http.post("/api/stop").json()["stopped"]
        assert running.http.post("/api/runs", json={"protocol": "trapezoid_2hz"}).status_code == 409
        assert running.http.post("/api/arm").json() == {"safety": "armed"}  # waits until the jaws rest
        assert running.http.post("/api/disarm").json() == {"safety": "disarmed"}


def test_a_stop_is_obeyed_whatever_stands_in_it(service):
    for content in (b"{", b'{"by": 7}', b"\xff", b'{"unknown": true}', b'{"by": "' + 2**20 * b"x" + b'"}'):
        run = service.run(protocol="trapezoid_025hz", cycles=5, tissue="bladder")
        answer = service.http.post("/api/stop", content=content, headers={"Content-Type": "application/json"})
        assert (answer.status_code, answer.json()["stopped"]) == (200, True)
        assert service.http.get(f"/api/runs/{run['id']}").json()["state"] == "stopped"


def test_a_stop_is_obeyed_though_whoever_sent_it_is_gone(service):
    run = service.run(protocol="trapezoid_025hz", cycles=5, tissue="bladder")
    with socket.create_connection(("127.0.0.1", service.port)) as line:
        line.sendall(b"POST /api/stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n{")
        time.sleep(0.02)
    assert service.finished(run["id"])["state"] == "stopped"


@pytest.mark.parametrize("attempt", range(3))
def test_of_starts_at_the_same_moment_one_is_obeyed_and_its_run_is_known_to_its_end(service, attempt):
    service.http.post("/api/disarm")
    wanted = {"protocol": "trapezoid_4hz", "cycles": 1, "tissue": "bladder"}
    with ThreadPoolExecutor(4) as crowd:
        answers = list(crowd.map(lambda _: httpx.post(f"{service.url}/api/runs", json=wanted), range(4)))
    [obeyed] = [answer.json() for answer in answers if answer.status_code == 201]
    assert [answer.status_code for answer in answers].count(409) == 3
    assert service.finished(obeyed["id"])["state"] == "finished"


def test_a_stop_during_the_self_test_of_a_start_lets_nothing_begin(service):
    service.http.post("/api/disarm")
    with Listener(service) as listener, ThreadPoolExecutor(1) as other:
        wanted = {"protocol": "trapezoid_025hz", "cycles": 5, "tissue": "bladder"}
        asked = other.submit(httpx.post, f"{service.url}/api/runs", json=wanted)
        listener.listen(lambda: "testing" in [state["safety"] for state in listener.of("state")])
        assert service.http.post("/api/stop").status_code == 200
        assert asked.result().status_code == 409
    assert service.http.post("/api/stop").json()["stopped"] is False


def test_what_a_held_up_worker_hears_too_late_is_not_obeyed_except_a_stop(service):
    service.http.post("/api/disarm")
    acquisition = service.worker("acquisition")
    with Listener(service) as listener:
        listener.listen(lambda: [state["safety"] for state in listener.of("state")][-1:] == ["disarmed"])
        begin = len(listener.messages)
        os.kill(acquisition, signal.SIGSTOP)
        try:
            assert service.http.post("/api/arm").status_code >= 400
            halfway = len(listener.messages)
        finally:
            os.kill(acquisition, signal.SIGCONT)
        listener.listen(lambda: len([each for each in listener.messages[halfway:] if each["type"] == "state"]) > 3)
        states = [each for each in listener.messages[begin:] if each["type"] == "state"]
        assert {state["safety"] for state in states} == {"disarmed"}
        run = service.run(protocol="trapezoid_025hz", cycles=5, tissue="bladder")
        os.kill(acquisition, signal.SIGSTOP)
        try:
            assert service.http.post("/api/stop").status_code == 503
        finally:
            os.kill(acquisition, signal.SIGCONT)
    assert service.finished(run["id"])["state"] == "stopped"
