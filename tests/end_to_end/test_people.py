"""Who is let in, and what each may do: a service that others can reach, over real sockets."""

import json
import socket
import ssl
import time
from pathlib import Path

import httpx
import pytest
from certificates import self_signed
from people import bearer, config_with, give_tokens
from service import Service, until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from app.messages.people import Role
from app.people import tokens

LEASE_S = 6.0
MOST_CONNECTIONS = 60
LONG_RUN = {"protocol": "trapezoid_025hz", "cycles": 20, "tissue": "liver"}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def token(data):
    return give_tokens(data)


@pytest.fixture(scope="module")
def open_service(data, token, tmp_path_factory):
    limits = {"requests_per_s": 20, "burst_requests": 150, "most_connections": MOST_CONNECTIONS}
    config = config_with(tmp_path_factory.mktemp("config"), control_expires_s=LEASE_S, **limits)
    proxied = config.read_text().replace("trusted_proxies = []", 'trusted_proxies = ["127.0.0.1"]')
    config.write_text(proxied)
    with Service("serve", "--host", "0.0.0.0", "--config", str(config), data=data) as running:
        time.sleep(2.0)  # asking whether it is ready has used up what a stranger may ask
        yield running


opened_clients: list[httpx.Client] = []


def open_client(**options) -> httpx.Client:
    """Open a client that is closed after the test."""
    opened_clients.append(httpx.Client(**options))
    return opened_clients[-1]


@pytest.fixture(autouse=True)
def _close_clients():
    yield
    while opened_clients:
        opened_clients.pop().close()


@pytest.fixture
def service(open_service, token):
    """With nothing under way and nobody in control."""
    yield open_service
    open_service.http.cookies.clear()
    open_service.http.post("/api/stop", headers=bearer(token[Role.ADMIN]))
    open_service.http.post("/api/control", json={"take_over": True}, headers=bearer(token[Role.ADMIN]))
    assert open_service.http.delete("/api/control", headers=bearer(token[Role.ADMIN])).json()["holder"] is None


@pytest.fixture
def somebody(service, data):
    """Calls of a new person, who is gone after the test: `somebody("Eve", Role.VIEWER)`."""
    given = []

    def come(name, role):
        given.append(name)
        headers = bearer(tokens.add_token(data, name, role))
        return open_client(base_url=service.url, headers=headers, timeout=5.0)

    yield come
    for name in given:
        if any(entry.name == name and entry.is_valid for entry in tokens.read_tokens(data)):
            tokens.revoke_token(data, name)


def problem(response, status):
    assert (response.status_code, response.headers["content-type"]) == (status, "application/problem+json")
    return response.json()["detail"]


def journal(service, token):
    return service.http.get("/api/journal", headers=bearer(token[Role.VIEWER])).json()


def signed_in(service, token):
    """A browser's calls; it says from which page it asks."""
    browser = open_client(base_url=service.url, headers={"Origin": service.url}, timeout=5.0)
    assert browser.post("/api/session", json={"token": token}).status_code == 200
    return browser


def cookie_header(browser):
    return "; ".join(f"{name}={value}" for name, value in browser.cookies.items())


def closed_with(viewer):
    """The code with which the service closes."""
    with pytest.raises(ConnectionClosed) as closed:
        while True:
            viewer.recv(timeout=10)
    return closed.value.rcvd.code


# --- without a token -------------------------------------------------------------------------------------------------


def test_a_stranger_gets_the_page_to_sign_in_and_nothing_else(service):
    assert service.http.get("/").status_code == 200
    assert service.http.get("/recordings").status_code == 200
    assert service.http.get("/api/session").json() == {"needed": True, "name": None, "role": None}
    health = service.http.get("/api/health").json()
    assert (health["status"], health["version"], health["workers"]) == ("ready", None, {})
    for path in ("/api/tool", "/api/runs", "/api/system", "/api/nope", "/metrics", "/openapi.json", "/docs", "/redoc"):
        response = service.http.get(path)
        problem(response, 401)
        assert response.headers["www-authenticate"].startswith("Bearer")
    problem(service.http.post("/api/stop"), 401)
    with pytest.raises(InvalidStatus) as refused:
        connect(service.live_url)
    assert refused.value.response.status_code == 401


@pytest.mark.parametrize("word", ["Bearer", "Bearer x", "Basic {}", "{}", "Bearer {}x", "Token {}"])
def test_only_a_whole_token_in_its_place_counts(service, token, word):
    headers = {"Authorization": word.format(token[Role.ADMIN])}
    assert service.http.get("/api/tool", headers=headers).status_code in (401, 429)
    assert service.http.get("/api/tool", params={"token": token[Role.ADMIN]}).status_code == 401


# --- with one --------------------------------------------------------------------------------------------------------


def test_a_viewer_watches_and_stops_and_does_nothing_else(service, token):
    viewer, admin = bearer(token[Role.VIEWER]), bearer(token[Role.ADMIN])
    run = service.http.post("/api/runs", json=LONG_RUN, headers=admin).json()
    assert "operator" in problem(service.http.post("/api/runs", json=LONG_RUN, headers=viewer), 403)
    problem(service.http.post("/api/alarms/x/acknowledge", json={"priority": "low"}, headers=viewer), 403)
    problem(service.http.delete("/api/recordings/x.mcap", headers=viewer), 403)
    problem(service.http.post("/api/control", json={}, headers=viewer), 403)
    assert service.http.get("/metrics", headers=viewer).status_code == 200
    with connect(service.live_url, additional_headers=viewer, max_size=None) as live:
        assert json.loads(live.recv(timeout=5))["type"] == "hello"
    stopped = service.http.post(f"/api/runs/{run['id']}/stop", headers=viewer).json()
    assert (stopped["stopped"], stopped["run"]["state"]) == (True, "stopped")
    line = next(line for line in journal(service, token) if line["text"].startswith("Stopped"))
    assert line["by"] == "Vera"


def test_nobody_acts_under_another_name(service, token):
    headers = bearer(token[Role.OPERATOR])
    run = service.http.post("/api/runs", json={**LONG_RUN, "by": "Ada"}, headers=headers).json()
    assert run["by"] == "Otto"
    service.http.post("/api/stop", json={"by": "Ada"}, headers=headers)
    lines = [line for line in journal(service, token) if line["kind"] == "run"]
    assert {line["by"] for line in lines[:2] if line["by"]} == {"Otto"}


def test_only_an_admin_deletes(service, token, data):
    path = data / "recordings" / "gone.lvm"
    path.write_text("LabVIEW Measurement\n")
    problem(service.http.delete("/api/recordings/gone.lvm", headers=bearer(token[Role.OPERATOR])), 403)
    assert path.exists()
    gone = service.http.delete("/api/recordings/gone.lvm", params={"by": "Otto"}, headers=bearer(token[Role.ADMIN]))
    assert (gone.status_code, path.exists()) == (204, False)
    assert next(line for line in journal(service, token) if line["kind"] == "deleted")["by"] == "Ada"


def test_no_name_leads_out_of_the_data_folder(service, token, data):
    (data / "recordings" / "link.lvm").symlink_to("/etc/hostname")
    headers = bearer(token[Role.ADMIN])
    names = ("..%2Fpeople.json", "%2e%2e/people.json", "..%2F..%2Fetc%2Fhostname", "%2Fetc%2Fhostname", "link.lvm")
    for name in names:
        for method, path in (("GET", f"{name}/file"), ("GET", f"{name}/report"), ("DELETE", name)):
            response = service.http.request(method, f"/api/recordings/{path}", headers=headers)
            assert response.status_code in (404, 405), (method, path)
            assert "sha256" not in response.text
    for body in ({"protocol": "../graspwatch"}, {"protocol": "/etc/hostname"}, {"protocol": "sine", "tissue": "../x"}):
        assert service.http.post("/api/runs", json=body, headers=headers).status_code == 422
    assert service.http.get("/api/studies/..%2F..%2Fpeople/figures", headers=headers).status_code == 404
    assert (data / "people.json").exists()


# --- browsers --------------------------------------------------------------------------------------------------------


def test_a_browser_signs_in_and_out(service, token):
    browser = open_client(base_url=service.url, headers={"Origin": service.url})
    assert browser.post("/api/session", json={"token": "wrong"}).status_code in (401, 429)
    response = browser.post("/api/session", json={"token": f" {token[Role.OPERATOR]}\n"})
    assert response.json() == {"needed": True, "name": "Otto", "role": "operator"}
    words = response.headers["set-cookie"].lower()
    assert "httponly" in words
    assert "samesite=strict" in words
    assert "secure" not in words
    assert token[Role.OPERATOR] not in words
    assert browser.get("/api/session").json()["name"] == "Otto"
    with connect(
        service.live_url, origin=service.url, additional_headers={"Cookie": cookie_header(browser)}, max_size=None
    ) as live:
        live.recv(timeout=5)
        kept = dict(browser.cookies)
        assert browser.delete("/api/session").status_code == 204
        assert closed_with(live) == 4401
    assert not browser.cookies
    browser.cookies.update(kept)  # whoever kept the cookie has nothing of it
    assert browser.get("/api/tool").status_code == 401
    texts = [(line["text"], line["by"]) for line in journal(service, token) if line["kind"] == "access"]
    assert texts[:2] == [("Signed out", "Otto"), ("Signed in as operator", "Otto")]


def test_another_sites_page_can_do_nothing_with_ones_cookie(service, token):
    browser = signed_in(service, token[Role.ADMIN])
    for origin in ("http://evil.example", "null", f"http://127.0.0.1:{service.port + 1}", f"{service.url}.evil"):
        problem(browser.post("/api/stop", headers={"Origin": origin}), 403)
        problem(browser.post("/api/runs", json=LONG_RUN, headers={"Origin": origin}), 403)
        with pytest.raises(InvalidStatus) as refused:
            connect(service.live_url, origin=origin, additional_headers={"Cookie": cookie_header(browser)})
        assert refused.value.response.status_code == 403
    del browser.headers["Origin"]  # every browser says it
    problem(browser.post("/api/stop"), 403)
    assert "access-control-allow-origin" not in browser.get("/api/tool").headers


def test_pages_cannot_be_framed_sniffed_or_made_to_load_from_elsewhere(service, token):
    for path in ("/", "/api/tool", "/docs"):
        headers = service.http.get(path, headers=bearer(token[Role.VIEWER])).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["x-frame-options"] == "DENY"
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert "default-src 'self'" in headers["content-security-policy"]


def test_who_loses_his_token_is_out_at_once(service, token, somebody, data):
    eve = somebody("Eve", Role.OPERATOR)
    assert eve.post("/api/control", json={}).json()["holder"] == "Eve"
    word = {"Authorization": eve.headers["Authorization"]}
    browser = signed_in(service, word["Authorization"].removeprefix("Bearer "))
    cookie = {"Cookie": cookie_header(browser)}
    with (
        connect(service.live_url, additional_headers=word, max_size=None) as program,
        connect(service.live_url, origin=service.url, additional_headers=cookie, max_size=None) as page,
        connect(service.live_url, additional_headers=bearer(token[Role.VIEWER]), max_size=None) as other,
    ):
        for live in (program, page, other):
            live.recv(timeout=5)
        tokens.revoke_token(data, "Eve")
        began = time.monotonic()
        assert eve.get("/api/tool").status_code == browser.get("/api/tool").status_code == 401
        assert (closed_with(program), closed_with(page)) == (4401, 4401)
        assert time.monotonic() - began < 5.0
        other.recv(timeout=5)
    assert service.http.get("/api/control", headers=bearer(token[Role.VIEWER])).json()["holder"] is None
    texts = [line["text"] for line in journal(service, token)]
    assert "The token of Eve (operator) was taken back" in texts
    assert "Eve has a token (operator)" in texts


# --- control ---------------------------------------------------------------------------------------------------------


def test_one_operator_has_control_until_another_takes_it_over(service, token, somebody):
    otto, olga = bearer(token[Role.OPERATOR]), somebody("Olga", Role.OPERATOR)
    quick = {"protocol": "trapezoid_4hz", "cycles": 1, "tissue": "liver"}
    assert service.http.post("/api/runs", json=quick, headers=otto).status_code == 201
    service.http.post("/api/stop", headers=otto)
    refused = problem(olga.post("/api/runs", json=quick), 409)
    assert "Otto has control" in refused
    assert "take_over" in refused
    assert "Otto" in problem(olga.post("/api/control", json={}), 409)
    problem(olga.delete("/api/control"), 409)
    with connect(service.live_url, additional_headers=otto, max_size=None) as live:
        assert olga.post("/api/control", json={"take_over": True}).json()["holder"] == "Olga"
        messages = (json.loads(each) for each in iter(lambda: live.recv(timeout=5), None) if isinstance(each, str))
        until(lambda: (each := next(messages))["type"] == "event" and "taken over from Otto" in each["text"])
        until(lambda: (each := next(messages))["type"] == "state" and each["control"] == "Olga")
    assert "Olga has control" in problem(service.http.post("/api/runs", json=quick, headers=otto), 409)
    assert olga.delete("/api/control").json() == {"holder": None, "expires_in_s": 0.0}
    assert service.http.post("/api/runs", json=quick, headers=otto).status_code == 201
    told = [(line["text"], line["by"]) for line in journal(service, token) if line["kind"] == "access"]
    assert ("Control taken over from Otto", "Olga") in told
    assert ("Control given back", "Olga") in told


@pytest.mark.long
def test_who_does_nothing_loses_control_but_not_during_his_run(service, token, somebody):
    otto, olga = bearer(token[Role.OPERATOR]), somebody("Olga", Role.OPERATOR)
    service.http.post("/api/runs", json=LONG_RUN, headers=otto)
    time.sleep(LEASE_S + 1.5)
    held = olga.get("/api/control").json()
    assert held["holder"] == "Otto"
    assert held["expires_in_s"] > LEASE_S / 2
    assert olga.post("/api/stop").json()["stopped"] is True  # STOP asks nobody
    problem(olga.post("/api/control", json={}), 409)
    until(lambda: time.sleep(0.2) or olga.post("/api/control", json={}).status_code == 200, LEASE_S + 3.0)
    assert olga.get("/api/control").json()["holder"] == "Olga"


# --- bounds ----------------------------------------------------------------------------------------------------------


def test_what_is_too_large_is_refused(service, token):
    headers = {**bearer(token[Role.ADMIN]), "Content-Type": "application/json"}
    problem(service.http.post("/api/runs", content=b" " * 70_000, headers=headers), 413)
    pieces = (b" " * 1000 for _ in range(100))  # of unknown length
    problem(service.http.post("/api/runs", content=pieces, headers=headers), 413)
    problem(service.http.post("/api/session", content=b" " * 70_000, headers=headers), 413)
    with connect(service.live_url, additional_headers=bearer(token[Role.VIEWER]), max_size=None) as live:
        live.send("x" * 70_000)
        assert closed_with(live) == 1009


def test_wrong_tokens_are_slowed_down_and_told_and_lock_nobody_out(service, token):
    def wrong():
        return service.http.post("/api/session", json={"token": "guess"})

    response = until(lambda: found if (found := wrong()).status_code == 429 else None)
    assert int(response.headers["retry-after"]) >= 1
    assert service.http.get("/api/tool", headers=bearer("guess")).status_code == 429
    assert service.http.get("/api/tool", headers=bearer(token[Role.VIEWER])).status_code == 200
    signed_in(service, token[Role.VIEWER])
    assert any("not good came from 127.0.0.1" in line["text"] for line in journal(service, token))


def test_a_cookie_stays_within_tls_that_a_proxy_ends(service, token):
    for said, is_secure in (({}, False), ({"X-Forwarded-Proto": "https"}, True)):
        response = httpx.post(f"{service.url}/api/session", json={"token": token[Role.VIEWER]}, headers=said)
        assert ("secure" in response.headers["set-cookie"].lower()) is is_secure


def test_who_asks_too_often_waits_but_stops_all_the_same(service, token, somebody):
    eve = somebody("Eve", Role.VIEWER)
    answers = (eve.get("/api/session") for _ in range(3000))
    response = next(answer for answer in answers if answer.status_code == 429)
    assert int(response.headers["retry-after"]) >= 1
    assert [eve.post("/api/stop").status_code for _ in range(50)] == [200] * 50
    assert service.http.get("/api/tool", headers=bearer(token[Role.VIEWER])).status_code == 200


def test_a_crowd_of_connections_keeps_out_neither_stop_nor_viewers(service, token):
    headers = bearer(token[Role.VIEWER])
    with connect(service.live_url, additional_headers=headers, max_size=None) as live:
        crowd = [socket.create_connection(("127.0.0.1", service.port)) for _ in range(2 * MOST_CONNECTIONS)]
        for half, end in enumerate(crowd):
            if half % 2:
                end.sendall(b"POST /api/session HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n")  # and no body
        assert httpx.post(f"{service.url}/api/stop", headers=headers).status_code == 200
        with connect(service.live_url, additional_headers=headers, max_size=None) as late:
            late.recv(timeout=5)
        live.recv(timeout=5)
        open_ones = Path(f"/proc/{service.process.pid}/net/tcp").read_text()
        mine = [line.split() for line in open_ones.splitlines()[1:]]
        port = f"{service.port:04X}"
        established = [line for line in mine if line[1].endswith(f":{port}") and line[3] == "01"]
        assert len(established) <= MOST_CONNECTIONS + 5
        for end in crowd:
            end.close()


# --- TLS, secrets, loopback ------------------------------------------------------------------------------------------


@pytest.fixture
def certificate(tmp_path):
    return self_signed(tmp_path)


def test_over_tls_and_no_secret_is_left_anywhere(certificate, tmp_path):
    data = tmp_path / "data"
    data.mkdir()
    token = give_tokens(data)
    trust = ssl.create_default_context(cafile=certificate[0])
    arguments = ("--tls-cert", str(certificate[0]), "--tls-key", str(certificate[1]))
    with Service("serve", "--host", "0.0.0.0", *arguments, data=data, trust=trust) as running:
        assert running.url.startswith("https://")
        waiting = socket.create_connection(("127.0.0.1", running.port), timeout=5.0)  # and never says a word
        running.http.headers["Origin"] = running.url
        response = running.http.post("/api/session", json={"token": token[Role.ADMIN]})
        assert "secure" in response.headers["set-cookie"].lower()
        cookie = cookie_header(running.http)
        with connect(
            running.live_url, ssl=trust, origin=running.url, additional_headers={"Cookie": cookie}, max_size=None
        ) as live:
            assert json.loads(live.recv(timeout=5))["type"] == "hello"
        run = running.run(protocol="trapezoid_4hz", cycles=1, tissue="liver")
        running.finished(run["id"])
        wrong = "gw_wrong-0123456789"
        said = [
            running.http.get("/api/tool", headers=bearer(wrong)),
            running.http.post("/api/session", json={"token": wrong}),
            running.http.post("/api/session", json={"token": {"is": wrong}}),
            running.http.get("/api/system"),
            running.http.get("/api/journal"),
        ]
        until(lambda: list((data / "recordings").glob("*.mcap")))
        with pytest.raises((httpx.TransportError, AssertionError)):
            assert httpx.get(running.url.replace("https", "http")).status_code == 200
        assert waiting.recv(1) == b""  # it was not waited for
        running.end()
        printed = "".join(running.process.communicate())
    assert "unencrypted" not in printed
    secrets = [*token.values(), cookie.partition("=")[2], wrong]
    kept = [path.read_bytes() for path in data.rglob("*") if path.is_file()]
    assert len(kept) > 3
    for secret in secrets:
        assert secret not in printed
        assert not any(secret in response.text for response in said)
        assert not any(secret.encode() in content for content in kept)
    hashes_kept = [entry.sha256 for entry in tokens.read_tokens(data)]
    assert not any(each in response.text for each in hashes_kept for response in said)


def test_in_the_clear_is_warned_of(open_service):
    # what it printed at its start is waiting to be read
    line = ""
    while "unencrypted" not in line:
        line = open_service.process.stderr.readline()
        assert line


def test_on_this_machine_alone_nobody_needs_a_token_until_there_is_one(tmp_path):
    config = config_with(tmp_path, requests_per_s=20, burst_requests=150)
    with Service("serve", "--config", str(config)) as running:
        assert running.http.get("/api/session").json() == {"needed": False, "name": None, "role": "admin"}
        assert "tokens" in problem(running.http.post("/api/session", json={"token": "x"}), 409)
        assert "tokens" in problem(running.http.post("/api/control", json={}), 409)
        foreign = [{"Host": "evil.example"}, {"X-Forwarded-For": "192.0.2.7"}, {"Origin": "http://evil.example"}]
        for headers in foreign:
            problem(running.http.post("/api/stop", headers=headers), 403)
            address = running.live_url.replace("127.0.0.1", headers.pop("Host", "127.0.0.1"))
            line = socket.create_connection(("127.0.0.1", running.port))
            with pytest.raises(InvalidStatus) as refused:
                connect(address, sock=line, additional_headers=headers)
            assert refused.value.response.status_code == 403
        problem(running.http.get("/api/system", headers={"Host": "evil.example"}), 403)
        lines = len((running.data / "journal.jsonl").read_text().splitlines())
        answers = [running.http.post("/api/stop", headers={"Origin": "http://evil.example"}) for _ in range(300)]
        assert {answer.status_code for answer in answers} == {403, 429}
        assert len((running.data / "journal.jsonl").read_text().splitlines()) - lines < 250
        time.sleep(1.0)  # until this address may ask again
        with connect(running.live_url, max_size=None) as live:
            live.recv(timeout=5)
            token = tokens.add_token(running.data, "Ada", Role.ADMIN)
            problem(running.http.get("/api/tool"), 401)
            assert closed_with(live) == 4401
        assert running.http.get("/api/tool", headers=bearer(token)).status_code == 200
        (running.data / "people.json").unlink()
        problem(running.http.get("/api/tool"), 401)
        problem(running.http.get("/api/tool", headers=bearer(token)), 401)
