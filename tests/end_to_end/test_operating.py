"""What an administrator has: logs, the file for support, metrics with their dashboard and alerts."""

import json
import os
import re
import signal
import subprocess
import zipfile
from pathlib import Path

import pytest
from service import PROGRAM, Listener, Service, until

from app.messages.people import Role
from app.people import tokens

DEPLOY = Path(__file__).parents[2] / "deploy"


@pytest.fixture(scope="module")
def service():
    with Service("serve") as running:
        yield running


def lines(service: Service) -> list[dict]:
    path = service.data / "logs/graspwatch.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def test_each_line_of_the_log_says_which_run_and_grasp_it_is_of(service: Service) -> None:
    run = service.run(protocol="strong_2hz", cycles=2, tissue="bladder", by="Ada")["id"]
    service.finished(run)
    until(lambda: any(each["message"].startswith("Run finished") for each in lines(service)))
    told = lines(service)
    of_run = [each for each in told if each["run"] == run]
    assert of_run[0]["message"].startswith("Run started")
    assert of_run[-1]["message"].startswith("Run finished")
    assert {(each["level"], each["logger"], each["kind"]) for each in of_run} >= {("INFO", "graspwatch", "run")}
    assert all(re.match(r"\d{4}-\d\d-\d\dT[\d:.]+\+00:00$", each["at"]) for each in told)
    service.http.post("/api/stop")
    after = until(lambda: [each for each in lines(service)[len(told) :] if "Stopped" in each["message"]])
    assert {each["run"] for each in after} == {None}


def test_what_happens_within_a_grasp_names_it(service: Service) -> None:
    run = service.run(protocol="trapezoid_025hz", cycles=1, tissue="liver")["id"]
    with Listener(service) as listener:
        listener.listen(lambda: any(each["in_grasp"] for each in listener.of("identification")[-1:]))
        grasp = listener.of("identification")[-1]["grasp"]
    os.kill(service.worker("recorder"), signal.SIGKILL)
    died = until(lambda: [each for each in lines(service) if "recorder worker died" in each["message"]])
    service.http.post("/api/stop")
    assert {(each["run"], each["grasp"]) for each in died} == {(run, grasp)}


def test_on_the_error_output_it_speaks_json_where_it_is_told_to(tmp_path: Path) -> None:
    config = tmp_path / "settings.toml"
    config.write_text('[logs]\nlevel = "info"\nformat = "json"\nkeep = false\n')
    with Service("serve", "--config", str(config)) as running:
        running.finished(running.run(protocol="trapezoid_4hz", cycles=1, tissue="liver")["id"])
        running.end()
        _, said = running.process.communicate()
        spoken = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
        assert any(each["message"].startswith("Run started") and each["run"] for each in spoken)
        assert not (running.data / "logs").exists()


@pytest.mark.long
def test_the_file_for_support_has_what_is_asked_for_and_no_secret(tmp_path: Path) -> None:
    config, out = tmp_path / "settings.toml", tmp_path / "help.zip"
    config.write_text('index_url = "sqlite:///index.sqlite?password=hush-hush"\n')
    token = tokens.add_token(tmp_path, "Ward", Role.VIEWER, None)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/graspwatch.jsonl").write_text(f'{{"message": "somebody wrote {token} here"}}\n')
    with Service("serve", data=tmp_path) as running:
        environment = {**os.environ, "GRASPWATCH_TOKEN": token}
        command = [PROGRAM, "support", "--data", tmp_path, "--config", config, "--url", running.url, "--out", out]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60)
        assert done.returncode == 0, done.stderr
    with zipfile.ZipFile(out) as bundle:
        parts = {name: bundle.read(name).decode() for name in bundle.namelist()}
    assert {"about.json", "settings.json", "tool.json", "journal.json", "logs/graspwatch.jsonl"} <= set(parts)
    assert json.loads(parts["about.json"])["packages"]["numpy"]
    assert json.loads(parts["service/health.json"])["workers"]["acquisition"] == "running"
    assert "graspwatch_samples_total" in parts["service/metrics.txt"]
    everything = "".join(parts.values())
    assert token not in everything
    assert "hush-hush" not in everything
    again = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60)
    assert (again.returncode, "Name another with --out" in again.stderr) == (2, True)


def test_the_file_for_support_is_made_without_a_service(tmp_path: Path) -> None:
    out = tmp_path / "help.zip"
    command = [PROGRAM, "support", "--data", tmp_path, "--url", "http://127.0.0.1:9", "--out", out]
    assert subprocess.run(command, capture_output=True, timeout=60).returncode == 0
    with zipfile.ZipFile(out) as bundle:
        assert b"Nobody answers" in bundle.read("service/health.json.txt")


def expressions(of: str) -> list[str]:
    if of == "dashboard":
        board = json.loads((DEPLOY / "grafana/dashboards/graspwatch.json").read_text())
        return [target["expr"] for panel in board["panels"] for target in panel.get("targets", ())]
    return re.findall(r"expr: (.*)", (DEPLOY / "prometheus/alerts.yml").read_text())


@pytest.mark.parametrize("of", ["dashboard", "alerts"])
def test_every_metric_that_is_watched_exists_from_the_start(service: Service, of: str) -> None:
    told = set(re.findall(r"^([a-z_]+)", service.http.get("/metrics").text, re.MULTILINE)) | {"up"}
    names = re.compile(r"\b(?:graspwatch|process)_[a-z_]+|\bup\b")
    watched = {name for each in expressions(of) for name in names.findall(each)}
    assert len(watched) > 5
    assert watched - told <= {"graspwatch_phase"}  # also a label of its own metric


def test_every_worker_and_label_has_its_series_before_its_first_event(service: Service) -> None:
    text = service.http.get("/metrics").text
    assert set(re.findall(r'^graspwatch_worker_deaths_total\{worker="(\w+)"\}', text, re.M)) == set(
        service.conditions()
    )
    tissues = {each["name"] for each in service.http.get("/api/tissues").json()["tissues"]}
    assert set(re.findall(r'^graspwatch_grasps_total\{label="(\w+)"\}', text, re.M)) == tissues | {
        "unknown",
        "undecided",
        "no_answer",
    }


def test_the_metrics_say_where_the_tool_stands(service: Service) -> None:
    def metric(name: str) -> float:
        return float(re.search(rf"^{re.escape(name)} (\S+)$", service.http.get("/metrics").text, re.MULTILINE)[1])

    assert metric('graspwatch_phase{graspwatch_phase="idle"}') == 1
    assert metric("graspwatch_free_disk_bytes") > 1e6
    service.run(protocol="trapezoid_025hz", cycles=1, tissue="liver")
    until(lambda: metric("graspwatch_recording") == 1)
    os.kill(service.worker("estimator"), signal.SIGKILL)
    until(lambda: metric('graspwatch_alarms{kind="technical",priority="high"}') == 1)
    until(lambda: metric('graspwatch_alarms{kind="technical",priority="high"}') == 0)
    service.http.post("/api/stop")
    assert metric('graspwatch_worker_deaths_total{worker="estimator"}') == 1
