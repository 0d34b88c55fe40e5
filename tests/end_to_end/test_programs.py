"""What programs in any language rely on: the description, the methods, the errors, and a start that is sent twice."""

import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import jsonschema
import pytest
from people import RIGHTS, bearer, give_tokens
from service import Listener, Service, until
from simulation import joined, simulate_raw, write_lvm

from app.messages.people import Role
from app.people import tokens

CHECKOUT = Path(__file__).parents[2]
ASYNCAPI_SCHEMA = CHECKOUT / "frontend/node_modules/@asyncapi/specs/schemas/3.0.0.json"
GENERATOR = Path(sys.executable).with_name("openapi-python-client")
LONG_RUN = {"protocol": "trapezoid_025hz", "cycles": 5, "tissue": "bladder", "by": "Ada"}


@pytest.fixture(scope="module")
def service() -> Iterator[Service]:
    with Service("serve") as running:
        write_lvm(running.data / "recordings" / "liver.lvm", joined(simulate_raw("liver")))
        yield running


@pytest.fixture(scope="module")
def description(service: Service) -> dict[str, Any]:
    return service.http.get("/openapi.json").json()


def operations(description: dict[str, Any]) -> list[dict[str, Any]]:
    return [operation for path in description["paths"].values() for operation in path.values()]


# --- the description ----------------------------------------------------------------------------------------------


def test_a_client_is_made_from_the_description_without_a_warning_and_starts_a_run(
    service: Service, description: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "openapi.json").write_text(json.dumps(description))
    (tmp_path / "options.yml").write_text("post_hooks: []")  # else it formats what it made
    options = ("--path", "openapi.json", "--output-path", "made_client", "--meta", "none", "--config", "options.yml")
    made = subprocess.run(
        [GENERATOR, "generate", *options, "--fail-on-warning"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (made.returncode, "arning" in made.stdout + made.stderr) == (0, False), made.stdout + made.stderr
    monkeypatch.syspath_prepend(tmp_path)
    models = importlib.import_module("made_client.models")
    calls = {name: importlib.import_module(f"made_client.api.runs.{name}") for name in ("start_run", "stop", "get_run")}
    body = models.RunRequest.from_dict(LONG_RUN)
    with importlib.import_module("made_client").Client(base_url=service.url) as client:
        run = calls["start_run"].sync(client=client, body=body)
        refused = calls["start_run"].sync(client=client, body=body)
        assert calls["stop"].sync(client=client).stopped
        assert calls["get_run"].sync(run.id, client=client).state == "stopped"
    assert (type(refused), refused.status, refused.run.id) == (models.Problem, 409, run.id)


def test_each_operation_has_a_short_name_and_a_group_with_a_description(description: dict[str, Any]) -> None:
    names = [operation["operationId"] for operation in operations(description)]
    assert {"startRun", "stopRun", "listRecordings", "downloadRecording"} <= set(names)
    assert len(names) == len(set(names)) == len([route for route in RIGHTS if route[0] != "WEBSOCKET"]) - 1  # /metrics
    assert all(name.isalpha() and name[0].islower() for name in names)
    groups = {tag["name"] for tag in description["tags"] if tag["description"]}
    assert {tag for operation in operations(description) for tag in operation["tags"]} == groups


def test_every_error_is_the_one_problem(description: dict[str, Any]) -> None:
    problem = {"application/problem+json": {"$ref": "#/components/schemas/Problem"}}
    for operation in operations(description):
        for status, response in operation["responses"].items():
            if int(status) >= 400 and "Health" not in str(response) and status != "416":
                assert {kind: each["schema"] for kind, each in response["content"].items()} == problem, operation
    assert not {"HTTPValidationError", "ValidationError"} & set(description["components"]["schemas"])


def test_every_json_body_has_an_example_that_is_one(description: dict[str, Any]) -> None:
    found = 0
    for operation in operations(description):
        for body in (operation.get("requestBody", {}), *operation["responses"].values()):
            for kind, content in body.get("content", {}).items():
                if kind.endswith("json") and content["schema"] != {"type": "object"}:
                    schema = {**content["schema"], "components": description["components"]}
                    jsonschema.validate(content["example"], schema)
                    found += 1
    assert found > 40


# --- methods ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/", "/docs", "/openapi.json", "/metrics", "/api/health", "/api/runs", "/api/bin"])
def test_head_answers_as_get_without_a_body(service: Service, path: str) -> None:
    asked, told = service.http.get(path), service.http.head(path)
    assert (told.status_code, told.headers["content-type"]) == (asked.status_code, asked.headers["content-type"])
    assert told.content == b""


def test_head_on_a_recording_reads_none_of_it_and_makes_no_report(service: Service) -> None:
    def read_bytes() -> int:
        counters = Path(f"/proc/{service.process.pid}/io").read_text()
        return int(counters.split("rchar: ")[1].split()[0])

    big = service.data / "recordings" / "big.mcap"
    with big.open("wb") as file:
        file.truncate(400_000_000)  # a hole: it takes no disk
    try:
        before = read_bytes()
        told = service.http.head("/api/recordings/big.mcap/file")
        assert (told.status_code, told.headers["content-length"]) == (200, "400000000")
        assert read_bytes() - before < 50_000_000
        part = service.http.head("/api/recordings/big.mcap/file", headers={"Range": "bytes=10-19"})
        assert (part.status_code, part.headers["content-length"]) == (206, "10")
        assert service.http.head("/api/recordings/none.mcap/file").status_code == 404
        assert [service.http.head("/api/recordings/liver.lvm/report").status_code for _ in range(2)] == [202, 202]
        assert not list((service.data / "reports").glob("*"))
        assert not [line for line in service.http.get("/api/journal").json() if line["action"] == "report"]
    finally:
        big.unlink()


def test_head_on_a_report_that_was_made_tells_its_length(service: Service) -> None:
    made = until(
        lambda: (found := service.http.get("/api/recordings/liver.lvm/report")).status_code == 200 and found, 150
    )
    told = service.http.head("/api/recordings/liver.lvm/report")
    assert (told.status_code, told.headers["content-length"]) == (200, str(len(made.content)))


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("DELETE", "/api/runs", "GET, HEAD, POST"),
        ("PUT", "/api/calibration", "DELETE, GET, HEAD, POST"),
        ("GET", "/api/stop", "POST"),
        ("PATCH", "/api/bin", "DELETE, GET, HEAD"),
        ("POST", "/recordings", "GET, HEAD"),
        ("POST", "/favicon.svg", "GET, HEAD"),
    ],
)
def test_a_wrong_method_is_told_every_right_one(service: Service, method: str, path: str, allowed: str) -> None:
    refused = service.http.request(method, path)
    assert (refused.status_code, refused.headers["allow"]) == (405, allowed)


def test_what_does_not_exist_has_no_methods(service: Service) -> None:
    refused = service.http.post("/api/none")
    assert (refused.status_code, "allow" in refused.headers) == (404, False)


def test_head_needs_the_role_of_get(tmp_path: Path) -> None:
    token = give_tokens(tmp_path)
    with Service("serve", "--host", "0.0.0.0", data=tmp_path) as running:
        paths = [path for (method, path), role in RIGHTS.items() if method == "GET" and role and "{" not in path]
        assert {running.http.head(path).status_code for path in paths} == {401}
        assert running.http.head("/api/audit/export", headers=bearer(token[Role.OPERATOR])).status_code == 403
        assert running.http.head("/api/audit/export", headers=bearer(token[Role.ADMIN])).status_code == 200
        assert running.http.head("/api/health").status_code == 200


# --- errors -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b'{"protocol": "sine",\n "cycles": }', "line 2, column 12: a value is missing"),
        (b'{"protocol": "sine"\n "cycles": 3}', "line 2, column 2: a comma or a closing bracket is missing"),
        (b'{"protocol" "sine"}', "line 1, column 13: a colon is missing"),
        (b"{protocol: 3}", "line 1, column 2: a name in double quotes is expected"),
        (b'{"protocol": "sine}', "line 1, column 14: the text that begins here has no closing quotation mark"),
        (b'{"protocol": "sine"} 7', "line 1, column 22: the JSON has ended before this place"),
        ('{"protocol": "sinüs" x'.encode(), "line 1, column 22: a comma"),
    ],
)
def test_broken_json_is_named_by_line_and_column(service: Service, content: bytes, says: str) -> None:
    refused = service.http.post("/api/runs", content=content, headers={"Content-Type": "application/json"})
    [error] = refused.json()["errors"]
    assert (refused.status_code, error["field"]) == (422, "body")
    assert says in error["message"]


@pytest.mark.parametrize("content", [b'{"protocol": "\xff"}', b"[" * 50_000])
def test_a_body_that_is_no_text_is_said_to_be_none(service: Service, content: bytes) -> None:
    refused = service.http.post("/api/runs", content=content, headers={"Content-Type": "application/json"})
    assert (refused.status_code, "Send JSON in UTF-8" in refused.json()["detail"]) == (400, True)


def test_a_refused_start_names_the_run_that_is_under_way(service: Service) -> None:
    run = service.run(**LONG_RUN)
    refused = service.http.post("/api/runs", json={"protocol": "sine", "by": "Bob"})
    service.http.post("/api/stop")
    problem = refused.json()
    assert (refused.status_code, problem["run"]["id"], problem["run"]["by"]) == (409, run["id"], "Ada")
    assert "A run is under way: trapezoid_025hz, started by Ada" in problem["detail"]


# --- a start that is sent twice -----------------------------------------------------------------------------------


def start(service: Service, key: str, token: str | None = None, **body: Any) -> httpx.Response:
    headers = {"Idempotency-Key": key} | (bearer(token) if token else {})
    return httpx.post(f"{service.url}/api/runs", json=body, headers=headers)


def test_a_start_that_is_sent_again_starts_nothing_and_gets_the_first_answer(service: Service) -> None:
    before = int(service.http.get("/api/runs").headers["x-total-count"])
    first = start(service, "once", **LONG_RUN)
    again = start(service, "once", **LONG_RUN)
    service.http.post("/api/stop")
    late = start(service, "once", **LONG_RUN)
    assert [each.status_code for each in (first, again, late)] == [201, 201, 201]
    assert first.json() == again.json() == late.json()
    until(lambda: int(service.http.get("/api/runs").headers["x-total-count"]) == before + 1)
    lines = [line["text"] for line in service.http.get("/api/journal").json() if line["action"] == "start_run"][:3]
    assert lines[2] == "Start run trapezoid_025hz on bladder: done"
    assert all(line.startswith("Repeat the start of run trapezoid_025hz") for line in lines[:2])


def test_a_key_belongs_to_one_body(service: Service) -> None:
    start(service, "one body", **LONG_RUN)
    service.http.post("/api/stop")
    refused = start(service, "one body", **{**LONG_RUN, "cycles": 6})
    assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, "Idempotency-Key")
    assert "with another body" in refused.json()["detail"]


def test_a_refused_start_is_carried_out_when_it_is_sent_again(service: Service) -> None:
    service.run(**LONG_RUN)
    refused = start(service, "later", protocol="trapezoid_4hz", cycles=1)
    service.http.post("/api/stop")
    obeyed = start(service, "later", protocol="trapezoid_4hz", cycles=1)
    assert (refused.status_code, obeyed.status_code) == (409, 201)
    service.http.post("/api/stop")


def test_starts_with_one_key_at_the_same_moment_are_one_and_a_stop_does_not_wait_for_them(service: Service) -> None:
    service.http.post("/api/disarm")  # the self-test makes the start last a while
    with Listener(service) as listener, ThreadPoolExecutor(3) as crowd:
        asked = [crowd.submit(start, service, "crowd", **LONG_RUN) for _ in range(3)]
        listener.listen(lambda: "testing" in [state["safety"] for state in listener.of("state")])
        assert service.http.post("/api/stop").elapsed.total_seconds() < 0.5
        assert not any(each.done() and each.result().status_code == 201 for each in asked)
        answers = [each.result() for each in asked]
    service.http.post("/api/stop")
    assert {answer.status_code for answer in answers} <= {201, 409}
    assert len({answer.json()["id"] for answer in answers if answer.status_code == 201}) <= 1


def test_nobody_gets_the_answer_to_another_persons_request(tmp_path: Path) -> None:
    ada, otto = (tokens.add_token(tmp_path, name, Role.OPERATOR) for name in ("Ada", "Otto"))
    with Service("serve", "--host", "0.0.0.0", data=tmp_path) as running:
        body = {"protocol": "trapezoid_4hz", "cycles": 1}
        mine = start(running, "same", ada, **body)
        assert mine.status_code == 201
        theirs = start(running, "same", otto, **body)
        assert (theirs.status_code, mine.json()["id"] in theirs.text) == (409, False)
        assert "Ada has control" in theirs.json()["detail"]
        assert start(running, "same", ada, **body).json() == mine.json()
        assert start(running, "same", **body).status_code == 401


# --- a stream that goes on ----------------------------------------------------------------------------------------


def events(listener: Listener) -> list[dict[str, Any]]:
    return [message for message in listener.messages if message.get("number")]


def greet(service: Service, after: int) -> Listener:
    return Listener(service, f"/api/live?after={after}")


def test_a_viewer_that_comes_again_gets_every_event_since_and_none_twice(service: Service) -> None:
    with Listener(service) as whole:
        with Listener(service) as first:
            first.listen(lambda: first.of("state")[-1:] and first.of("state")[-1]["event_number"])
            run = service.run(protocol="trapezoid_4hz", cycles=2, tissue="liver", by="Ada")
            first.listen(lambda: any("Run started" in message["text"] for message in first.of("event")))
            last = events(first)[-1]["number"]
        service.finished(run["id"])
        with greet(service, last) as again:
            again.listen(lambda: any("Run finished" in message["text"] for message in again.of("event")))
            assert again.of("hello")[0]["resumed"] is True
            whole.listen(lambda: events(whole)[-1:] and events(whole)[-1]["number"] >= events(again)[-1]["number"])
        seen = {message["number"]: message for message in events(first) + events(again)}
        assert sorted(seen) == [message["number"] for message in [*events(first), *events(again)]]
        assert {message["type"] for message in events(again)} == {"event", "grasp"}
        told = {message["number"]: message for message in events(whole)}
        assert {number: told[number] for number in seen} == seen
        assert sorted(seen) == list(range(min(seen), max(seen) + 1))


def test_a_viewer_is_told_when_events_since_are_lost(service: Service) -> None:
    with Listener(service) as listener:
        listener.listen(lambda: listener.of("state")[-1:] and listener.of("state")[-1]["event_number"])
        newest = listener.of("state")[-1]["event_number"]
        assert listener.of("hello")[0]["resumed"] is None
    for after in (0, newest + 1_000_000, newest - 1_000_000):
        with greet(service, after) as listener:
            listener.listen(lambda: listener.of("hello"))
            assert listener.of("hello")[0]["resumed"] is False
    with greet(service, newest) as listener:
        listener.listen(lambda: listener.of("hello"))
        assert listener.of("hello")[0]["resumed"] is True


# --- the stream's description -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stream_description() -> dict[str, Any]:
    return json.loads((CHECKOUT / "docs/reference/asyncapi.json").read_text())


def test_the_streams_description_is_asyncapi(stream_description: dict[str, Any]) -> None:
    jsonschema.validate(stream_description, json.loads(ASYNCAPI_SCHEMA.read_text()))


def test_every_message_is_as_the_streams_description_says(service: Service, stream_description: dict[str, Any]) -> None:
    components = stream_description["components"]
    payloads = {
        components["schemas"][name]["properties"]["type"]["const"]: {**message["payload"], "components": components}
        for name, message in components["messages"].items()
        if "$ref" in message["payload"]
    }
    with Listener(service) as live, Listener(service, "/api/recordings/liver.lvm/replay") as replay:
        service.run(protocol="trapezoid_4hz", cycles=1, tissue="liver")
        live.listen(lambda: live.of("grasp") and live.of("identification") and live.of("event"))
        replay.listen(lambda: any(state["prepared"] == 1 for state in replay.of("replay_state")))
        messages = live.messages + replay.messages
    assert {"hello", "state", "identification", "grasp", "event", "replay_state"} <= {each["type"] for each in messages}
    for message in messages:
        jsonschema.validate(message, payloads[message["type"]])
