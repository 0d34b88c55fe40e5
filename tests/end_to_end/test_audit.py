"""Who did, or wanted, what, from where, and what came of it; and whether the journal still says so."""

import csv
import io
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from service import PROGRAM, Service, until


@pytest.fixture(scope="module")
def service() -> Iterator[Service]:
    with Service("serve") as running:
        yield running


def newest(service: Service) -> dict[str, object]:
    return service.http.get("/api/audit", params={"kind": "request", "limit": 1}).json()[0]


@pytest.mark.parametrize(
    ("method", "path", "asked", "line"),
    [
        ("POST", "/api/stop", {"json": {"by": "Ada"}}, ("Stop: done", "Ada", "done", None)),
        ("POST", "/api/stop", {}, ("Stop: done", None, "done", None)),
        (
            "POST",
            "/api/stop",
            {"content": b'{"by": "Ada\\ud800"}', "headers": {"Content-Type": "application/json"}},
            ("Stop: done", "Ada?", "done", None),
        ),
        (
            "POST",
            "/api/runs",
            {"json": {"protocol": "no_such", "by": "Eve"}},
            ("Start run no_such: refused", "Eve", "refused", "no_such"),
        ),
        ("POST", "/api/runs", {"json": {"by": "Eve"}}, ("Start run: refused", "Eve", "refused", "Field required")),
        ("POST", "/api/runs", {"content": b"\xff[{"}, ("Start run: refused", None, "refused", "")),
        ("POST", "/api/runs/nil/stop", {"json": {"by": "Eve"}}, ("Stop run nil: refused", "Eve", "refused", "no run")),
        (
            "POST",
            "/api/alarms/none/acknowledge",
            {"json": {"by": "Ada", "priority": "high"}},
            ("Acknowledge none: refused", "Ada", "refused", "no alarm"),
        ),
        (
            "DELETE",
            "/api/recordings/nil.mcap?by=Ada",
            {"headers": {"X-Forwarded-For": "192.0.2.7"}},
            ("DELETE /api/recordings/nil.mcap: refused", "Ada", "refused", ""),
        ),
        ("DELETE", "/api/recordings/nil.mcap?by=Ada", {}, ("Delete nil.mcap: refused", "Ada", "refused", "recording")),
        (
            "POST",
            "/api/studies",
            {"json": {"study": "astrology", "by": "Eve"}},
            ("Start study astrology, seed 0: refused", "Eve", "refused", "astrology"),
        ),
    ],
)
def test_a_request_for_a_change_is_noted_whatever_comes_of_it(
    service: Service, method: str, path: str, asked: dict, line: tuple
) -> None:
    response = service.http.request(method, path, **asked)
    noted = newest(service)
    text, by, result, reason = line
    assert (noted["text"], noted["by"], noted["result"]) == (text, by, result)
    said = response.request.headers.get("X-Forwarded-For")
    assert noted["client"].startswith("127.0.0.1" + (f" (x-forwarded-for: {said}" if said else ""))
    if reason is None:
        assert (response.status_code, noted["reason"]) == (200, None)
    else:
        assert noted["reason"] == response.json()["detail"]
        assert reason in noted["reason"]


def test_reading_and_addresses_that_are_none_leave_no_line(service: Service) -> None:
    service.http.post("/api/stop", json={"by": "Marker"})
    service.http.get("/api/runs")
    service.http.get("/api/system")
    service.http.post("/api/nothing", json={"by": "Eve"})
    assert newest(service)["by"] == "Marker"


def test_a_report_that_is_begun_or_cannot_be_made_is_noted_once(service: Service) -> None:
    (service.data / "recordings" / "broken.lvm").write_text("LabVIEW Measurement\n")
    address = "/api/recordings/broken.lvm/report"
    until(lambda: service.http.get(address).status_code == 422)
    lines = service.http.get("/api/audit", params={"kind": "request", "q": "report of broken.lvm"}).json()
    assert [(each["action"], each["result"]) for each in lines] == [("report", "failed"), ("report", "done")]


def audit(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([PROGRAM, "audit", *arguments], capture_output=True, text=True, timeout=60)


def test_the_journal_is_written_out_for_others(service: Service) -> None:
    service.http.post("/api/runs", json={"protocol": "no_such", "by": "=cmd()"})
    table = service.http.get("/api/audit/export", params={"format": "csv"})
    assert table.headers["content-type"].startswith("text/csv")
    rows = list(csv.DictReader(io.StringIO(table.text)))
    last = [row for row in rows if row["kind"] == "request"][-1]
    assert (last["by"], last["client"], last["result"]) == ("'=cmd()", "127.0.0.1", "refused")
    numbers = [int(row["number"]) for row in rows]
    assert numbers == list(range(1, len(rows) + 1))

    ada = service.http.get("/api/audit/export", params={"format": "jsonl", "by": "Ada"}).content.splitlines()
    journal = (service.data / "journal.jsonl").read_bytes().splitlines()
    assert ada == [line for line in journal if json.loads(line).get("by") == "Ada"]
    assert service.http.get("/api/audit/export", params={"until": "2020-01-01T00:00:00Z", "format": "jsonl"}).text == ""
    assert service.http.get("/api/audit/export", params={"since": "yesterday"}).status_code == 422
    shown = audit("export", "--format", "jsonl", "--by", "Ada", "--data", service.data)
    assert shown.stdout.encode().splitlines() == ada
    assert audit("export", "--since", "yesterday", "--data", service.data).returncode == 2


@pytest.mark.long
def test_a_journal_that_somebody_has_shortened_is_found_out(service: Service) -> None:
    """The last test of this service: it ends it. A run's recording and the index both know the lines."""
    service.finished(service.run(protocol="trapezoid_4hz", cycles=1, by="Ada")["id"])
    service.http.post("/api/runs", json={"protocol": "no_such", "by": "Eve"})
    lines = len((service.data / "journal.jsonl").read_bytes().splitlines())
    found = until(lambda: (now := service.http.get("/api/audit/check").json())["lines"] >= lines and now)
    assert (found["whole"], found["notes"]) == (True, [])
    until(lambda: service.http.get("/api/files").json())
    service.end()
    broken = service.data / "recordings" / "broken.lvm"
    for command, exit_code in ((("import", broken), 3), (("index", "--rebuild"), 0)):
        done = subprocess.run([PROGRAM, *command, "--data", service.data], capture_output=True, timeout=60)
        assert done.returncode == exit_code
    assert audit("verify", "--data", service.data).returncode == 0
    journal = service.data / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    local = [json.loads(line) for line in lines[-2:]]
    assert [(each["action"], each["result"]) for each in local] == [("import", "failed"), ("index", "done")]
    assert all(each["by"] and each["client"].startswith("this machine") for each in local)
    eve = next(number for number, line in enumerate(lines) if b"no_such" in line and b'"Eve"' in line)
    for name, changed, says in (
        ("changed", [*lines[:eve], lines[eve].replace(b'"Eve"', b'"Ada"'), *lines[eve + 1 :]], f"line {eve + 1}"),
        ("cut short", lines[:-2], "which the index knows"),
    ):
        journal.write_bytes(b"".join(changed))
        done = audit("verify", "--data", service.data)
        assert (done.returncode, says in done.stderr) == (7, True), (name, done.stderr)
    for path in service.data.glob("index.sqlite*"):
        path.unlink()
    started = next(number for number, line in enumerate(lines) if b"Run started" in line)
    journal.write_bytes(b"".join(lines[:started]))
    done = audit("verify", "--data", service.data, "--json")
    assert done.returncode == 7
    assert "which the recording" in json.loads(done.stdout)["problem"]

    journal.write_bytes(b"".join([*lines[:1], *lines[2:]]))
    with Service("serve", data=service.data) as after:
        alarm = until(lambda: [each for each in after.http.get("/api/alarms").json() if "journal" in each["text"]])[0]
        assert (alarm["priority"], "line 2: lines are missing" in alarm["text"]) == ("low", True)
        assert after.run(protocol="trapezoid_4hz", cycles=1)["state"] == "running"
