"""Sessions, the lease, rates, and where a request comes from."""

import pytest
from starlette.requests import Request

from app.http.rate_limiter import RateLimiter
from app.http.request_origin import is_encrypted, is_local_request, is_same_origin
from app.people.browser_sessions import MAX_SESSIONS_PER_TOKEN, BrowserSessions
from app.people.tokens import hash_secret
from app.service.control_lease import ControlLease
from config.errors import RefusedError
from config.schema import ServerSettings


class Clock:
    now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_a_session_ends_when_nothing_is_heard_of_it(clock: Clock) -> None:
    sessions = BrowserSessions(60.0, clock)
    key = hash_secret(sessions.begin("ada"))
    clock.now_s += 59.0
    sessions.touch(key)
    clock.now_s += 59.0
    assert sessions.find_token_hash(key) == "ada"
    clock.now_s += 2.0
    assert sessions.find_token_hash(key) is None
    sessions.touch(key)  # too late
    assert sessions.find_token_hash(key) is None


def test_a_session_is_ended_at_once_and_one_token_does_not_fill_the_memory(clock: Clock) -> None:
    sessions = BrowserSessions(60.0, clock)
    first = hash_secret(sessions.begin("ada"))
    other = hash_secret(sessions.begin("bob"))
    for _ in range(MAX_SESSIONS_PER_TOKEN):
        clock.now_s += 0.1
        last = hash_secret(sessions.begin("ada"))
    assert (sessions.find_token_hash(first), sessions.find_token_hash(last), sessions.find_token_hash(other)) == (
        None,
        "ada",
        "bob",
    )
    sessions.end(other)
    assert sessions.find_token_hash(other) is None


def test_one_has_control_until_he_does_nothing_gives_it_back_or_loses_it(clock: Clock) -> None:
    control = ControlLease(600.0, clock)
    assert control.acquire("ada") is None
    with pytest.raises(RefusedError, match=r"ada has control.*10\.0 min.*take_over"):
        control.acquire("bob")
    clock.now_s += 599.0
    control.renew("bob")  # changes nothing
    control.renew("ada")
    clock.now_s += 599.0
    assert (control.holder, control.acquire("ada")) == ("ada", "ada")
    assert control.acquire("bob", take_over=True) == "ada"
    assert (control.holder, control.release("ada"), control.release("bob"), control.holder) == (
        "bob",
        False,
        True,
        None,
    )
    control.acquire("bob")
    clock.now_s += 601.0
    assert (control.holder, control.expires_in_s) == (None, 0.0)
    control.renew("bob")  # it is not his any more
    assert control.acquire("ada") is None


def test_who_asks_too_often_waits_and_others_do_not(clock: Clock) -> None:
    rates = RateLimiter(rate_per_s=10.0, burst=5, clock=clock)
    assert [rates.consume_or_wait_s("eve") for _ in range(5)] == [0.0] * 5
    assert rates.consume_or_wait_s("eve") == pytest.approx(0.1)
    assert rates.consume_or_wait_s("ada") == 0.0
    clock.now_s += 0.11
    assert rates.consume_or_wait_s("eve") == 0.0
    assert rates.consume_or_wait_s("eve") > 0.0
    clock.now_s += 3600.0
    assert [rates.consume_or_wait_s("eve") for _ in range(6)].count(0.0) == 5


def asked_by(address: str | None, *headers: tuple[str, str], host: str | None = "localhost:8000") -> Request:
    named = [("host", host), *headers] if host is not None else headers
    raw = [(name.encode("latin-1"), value.encode("latin-1")) for name, value in named]
    return Request(
        {
            "type": "http",
            "client": address and (address, 5000),
            "server": ("127.0.0.1", 8000),
            "headers": raw,
            "path": "/",
            "scheme": "http",
            "query_string": b"",
        }
    )


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:8000", "[::1]:9999", "tool.example", "[fe80::1]"])
def test_who_sits_at_the_machine_asks_by_one_of_its_names(host: str) -> None:
    assert is_local_request(asked_by("127.0.0.1", host=host), ("tool.example", "[fe80::1]"))
    assert is_local_request(asked_by("::1", host=host), ("tool.example", "[fe80::1]"))
    assert not is_local_request(asked_by("192.0.2.7", host=host), ("tool.example", "[fe80::1]"))
    assert not is_local_request(asked_by(None, host=host), ("tool.example", "[fe80::1]"))


@pytest.mark.parametrize(
    "host",
    [
        "rebound.example",
        "localhost.example",
        "127.0.0.2",
        "127.1",
        "0.0.0.0",
        "[::]",
        "::1",
        "localhost.",
        "",
        " ",
        "localhost:",
        "localhost:x",
        "localhost:0",
        "user@localhost",
        "a{b.example",
        "a`b.example:8000",
        "localhost\xa0",
        "localhost, evil.example",
        "evil.example/localhost",
        None,
    ],
)
def test_any_other_name_is_none_of_this_machine(host: str | None) -> None:
    assert not is_local_request(asked_by("127.0.0.1", host=host), ())


def test_two_names_are_none() -> None:
    assert not is_local_request(asked_by("127.0.0.1", ("host", "localhost:8000")), ())


def test_the_address_it_listens_on_is_a_name_of_its_own() -> None:
    request = asked_by("127.0.0.5", host="127.0.0.5:8000")
    assert not is_local_request(request, ())
    request.scope["server"] = ("127.0.0.5", 8000)
    assert is_local_request(request, ())
    request = asked_by("::1", host="[fd00::5]:8000")
    request.scope["server"] = ("fd00::5", 8000)
    assert is_local_request(request, ())


@pytest.mark.parametrize(
    "name", ["X-Forwarded-For", "X-Forwarded-Host", "X-Forwarded-Proto", "X-Forwarded", "Forwarded", "Via", "X-Real-IP"]
)
@pytest.mark.parametrize("value", ["127.0.0.1", "for=127.0.0.1", ""])
def test_a_proxy_is_not_this_machine(name: str, value: str) -> None:
    assert not is_local_request(asked_by("127.0.0.1", (name.lower(), value)), ())


@pytest.mark.parametrize(
    ("sites", "here"),
    [
        (["same-origin"], True),
        (["none"], True),
        (["cross-site"], False),
        (["same-site"], False),
        ([""], False),
        (["none", "cross-site"], False),
        (["Same-Origin"], False),
    ],
)
def test_a_request_that_another_sites_page_makes_is_not_the_persons(sites: list[str], here: bool) -> None:
    said = [("sec-fetch-site", each) for each in sites]
    assert is_local_request(asked_by("127.0.0.1", *said), ()) is here
    assert not is_local_request(asked_by("127.0.0.1", ("origin", "null"), *said), ())
    assert is_local_request(asked_by("127.0.0.1", ("origin", "http://localhost:8000"), *said), ())


@pytest.mark.parametrize(
    ("host", "origin", "own"),
    [
        ("tool.example", "http://tool.example", True),
        ("tool.example", "https://tool.example", True),  # a proxy ended TLS
        ("tool.example:8000", "http://tool.example:8000", True),
        ("tool.example:443", "https://tool.example", True),
        ("[::1]:8000", "http://[::1]:8000", True),
        ("tool.example:8000", "http://tool.example:8001", False),
        ("tool.example", "http://tool.example.evil", False),
        ("tool.example", "http://evil", False),
        ("tool.example", "null", False),
        ("tool.example", "http://tool.example:x", False),
        ("tool.example", "file://", False),
        ("tool.example", "", False),
        ("tool.example", "tool.example", False),
        ("tool.example", "http://tool.example/", False),
        ("tool.example", "http://user@tool.example", False),
        ("tool.example", "http://tool.example http://tool.example", False),
        ("tool.example", "chrome-extension://tool.example", False),
        ("a{b.example", "http://a{b.example", False),
        ("", "http://", False),
    ],
)
def test_another_sites_page_is_told_by_its_origin(host: str, origin: str, own: bool) -> None:
    assert is_same_origin(asked_by("192.0.2.7", ("origin", origin), host=host)) is own
    assert is_same_origin(asked_by("192.0.2.7", ("origin", origin), ("origin", origin), host=host)) is False


def test_a_program_says_no_origin() -> None:
    assert is_same_origin(asked_by("192.0.2.7")) is None


@pytest.mark.parametrize(
    ("client", "scheme", "said", "encrypted"),
    [
        ("192.0.2.7", "https", [], True),
        ("192.0.2.7", "http", ["https"], False),  # no proxy of the settings
        ("10.1.2.3", "http", ["https"], True),
        ("10.1.2.3", "http", ["http"], False),
        ("10.1.2.3", "http", ["https", "https"], False),
        ("10.1.2.3", "http", ["https, http"], False),
        ("fd00::5", "http", ["https"], True),
        (None, "http", ["https"], False),
    ],
)
def test_only_a_proxy_of_the_settings_is_believed(
    client: str | None, scheme: str, said: list[str], encrypted: bool
) -> None:
    server = ServerSettings(trusted_proxies=("10.0.0.0/8", "fd00::5"))
    request = asked_by(client, *(("x-forwarded-proto", each) for each in said))
    request.scope["scheme"] = scheme
    assert is_encrypted(request, server) is encrypted
