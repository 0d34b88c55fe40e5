"""Who counts as sitting at this computer: raw bytes to a service without tokens, as any page or program sends them."""

import contextlib
import socket

import httpx
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from people import bearer, config_with, give_tokens
from service import Service

from app.messages.people import Role

EXAMPLES = settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
PORTS = {str(port).encode() for port in range(1, 65_536)}
NAMES = {b"localhost", b"127.0.0.1", b"[::1]"}
ODD = [b"a{b.example", b'a"b.example', b"evil.example", b"localhost.", b"user@localhost", b"127.1", b"::1"]
REFUSED = {400, 403}
NO_RUN = b'{"protocol": "none"}'


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    config = config_with(tmp_path_factory.mktemp("config"), requests_per_s=10_000, burst_requests=10_000)
    with Service("serve", "--config", str(config)) as running:
        yield running


def status(service, method, path, headers, body=b""):
    """Of the answer to exactly these bytes; 400 where the connection is closed without one."""
    lines = [b"%s %s HTTP/1.1" % (method, path), *headers, b"Content-Length: %d" % len(body), b"", body]
    with socket.create_connection(("127.0.0.1", service.port), 5.0) as line, contextlib.suppress(ConnectionError):
        line.sendall(b"\r\n".join(lines))
        answer = line.recv(65_536)
        if answer:
            return int(answer.split(b" ", 2)[1])
    return 400


def is_own(host):
    """Whether these bytes are exactly an allowed name, with or without a port; spaces around it are no part of it."""
    host = host.strip(b" \t").lower()
    name, _, port = host.rpartition(b":")
    return host in NAMES or (name in NAMES and port in PORTS)


def upgrade(headers):
    handshake = [b"Connection: Upgrade", b"Upgrade: websocket", b"Sec-WebSocket-Version: 13"]
    return [*headers, *handshake, b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="]


one_line = st.binary(max_size=30).filter(lambda value: not {*b"\r\n"}.intersection(value))
hosts = st.one_of(
    one_line,
    st.builds(
        lambda *parts: b"".join(parts),
        st.sampled_from([b"", b" ", b"user@", b"//", b"evil.example,", b"a{b."]),
        st.sampled_from([*NAMES, *ODD, b"LocalHost", b"127.0.0.2", b"[::1", b"[0:0:0:0:0:0:0:1]", b"", b"x" * 300]),
        st.sampled_from([b"", b".", b"\t", b"}", b"\xc2\xad", b"\x00", b"%00", b"/"]),
        st.sampled_from([b"", b":", b":8000", b":1", b":0", b":65535", b":65536", b":080", b":-1", b":8a", b":8000 "]),
    ),
)


@EXAMPLES
@given(host=hosts)
@example(host=b"localhost:8000")
@example(host=b"[::1]")
@example(host=b"a{b.example:8000")
def test_only_an_exactly_well_formed_name_of_its_own_is_this_computer(service, host):
    headers, own = [b"Host: " + host], is_own(host)
    reading = status(service, b"GET", b"/api/runs", headers)
    moving = status(service, b"POST", b"/api/runs", [*headers, b"Content-Type: application/json"], NO_RUN)
    stopping = status(service, b"POST", b"/api/stop", headers)
    watching = status(service, b"GET", b"/api/live", upgrade(headers))
    found = reading, moving, stopping, watching
    assert found == (200, 422, 200, 101) if own else REFUSED.issuperset(found), found


@EXAMPLES
@given(
    origin=st.one_of(
        one_line,
        st.builds(
            lambda *parts: b"".join(parts),
            st.sampled_from([b"http://", b"https://", b"HTTP://", b"ws://", b"file://", b"//", b""]),
            st.sampled_from([*NAMES, *ODD, b"null", b""]),
            st.sampled_from([b"", b":80", b":8000", b":8001", b":", b"/", b" ", b"#"]),
        ),
    )
)
@example(origin=b"null")
@example(origin=b"http://localhost:8000")
def test_only_its_own_page_may_move_or_watch(service, origin):
    headers = [b"Host: localhost:8000", b"Origin: " + origin]
    own = origin.strip(b" \t").lower() in (b"http://localhost:8000", b"https://localhost:8000")
    own = own and origin.strip(b" \t")[:4] == b"http"  # browsers write it so
    moving = status(service, b"POST", b"/api/runs", [*headers, b"Content-Type: application/json"], NO_RUN)
    watching = status(service, b"GET", b"/api/live", upgrade(headers))
    reading = status(service, b"GET", b"/api/runs", headers)
    found = moving, watching, reading
    assert found == (422, 101, 200) if own else REFUSED.issuperset(found), found


@pytest.mark.parametrize(
    "headers",
    [
        [],
        [b"Host: localhost", b"Host: localhost"],
        [b"Host: evil.example", b"Host: localhost"],
        [b"Host: localhost", b"Host: evil.example"],
        [b"Host : localhost"],
        [b"Host: local\r\n host"],
        [b"X-Host: localhost"],
        [b"Host: localhost", b"X-Forwarded-Host: localhost"],
        [b"Host: localhost", b"X-Forwarded-Proto: http"],
        [b"Host: localhost", b"Forwarded: host=localhost"],
        [b"Host: evil.example", b"X-Forwarded-Host: localhost"],
        [b"Host: localhost", b"Via: 1.1 localhost"],
        [b"Host: localhost", b"Origin: http://localhost", b"Origin: http://localhost"],
        [b"Host: localhost", b"Sec-Fetch-Site: cross-site"],
        [b"Host: localhost", b"Sec-Fetch-Site: same-site"],
    ],
)
def test_what_is_doubled_missing_or_said_by_a_proxy_or_another_page_moves_nothing(service, headers):
    as_json = [*headers, b"Content-Type: application/json"]
    assert status(service, b"POST", b"/api/runs", as_json, NO_RUN) in REFUSED
    assert status(service, b"GET", b"/api/live", upgrade(headers)) in REFUSED


@pytest.mark.parametrize("target", [b"http://localhost/api/runs", b"//localhost/api/runs", b"localhost/api/runs", b"*"])
def test_an_address_in_the_request_line_opens_nothing(service, target):
    for host in (b"Host: evil.example", b"Host: localhost"):
        assert status(service, b"GET", target, [host]) in {*REFUSED, 404}


def test_http_1_0_without_a_host_is_nobody(service):
    with socket.create_connection(("127.0.0.1", service.port), 5.0) as line:
        line.sendall(b"GET /api/runs HTTP/1.0\r\n\r\n")
        assert b" 403 " in line.recv(65_536).split(b"\r\n")[0]


def test_the_refusal_says_what_to_do(service):
    for host in ("evil.example", "a{b.example"):
        answer = httpx.get(f"{service.url}/api/tool", headers={"Host": host})
        assert (answer.status_code, answer.headers["content-type"]) == (403, "application/problem+json")
        assert "Open it at localhost" in answer.json()["detail"]
    assert httpx.get(f"{service.url}/", headers={"Host": "a{b.example"}).status_code == 403


def test_head_answers_what_get_answers_without_a_body(service):
    for path in ("/", "/api/health", "/api/runs", "/metrics", "/api/nothing"):
        get, head = service.http.get(path), service.http.head(path)
        assert (head.status_code, head.content) == (get.status_code, b"")


def test_with_tokens_and_names_in_the_settings_only_those_are_answered(tmp_path):
    config = config_with(tmp_path, requests_per_s=10_000)
    config.write_text(config.read_text().replace("hosts = []", 'hosts = ["grasp.example", "::1"]'))
    refused = Service("serve", "--config", str(config))
    with pytest.raises(AssertionError, match=r"'::1' is no name: write it as"), refused:
        pass
    config.write_text(config.read_text().replace('"::1"', '"[fd00::5]"'))
    token = give_tokens(tmp_path)[Role.ADMIN]
    with Service("serve", "--host", "0.0.0.0", "--config", str(config), data=tmp_path) as running:
        for host in ("grasp.example", "Grasp.Example:443", "localhost:1", "127.0.0.1", "[fd00::5]:8000", "[::1]"):
            answer = running.http.get("/api/tool", headers={**bearer(token), "Host": host})
            assert answer.status_code == 200, host
        for host in ("evil.example", "grasp.example.", "grasp.example.evil", "a{b.example", "127.0.0.2"):
            for path in ("/api/tool", "/api/health", "/"):
                answer = running.http.get(path, headers={**bearer(token), "Host": host})
                assert (answer.status_code, "server.hosts" in answer.text) == (403, True), (host, path)
        doubled = [*bearer(token).items(), *bearer(token).items()]
        assert httpx.get(f"{running.url}/api/tool", headers=doubled).status_code == 401
