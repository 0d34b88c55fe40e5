"""Sessions, the lease, rates, and where a request comes from."""

import pytest
from starlette.requests import Request

from app.people.lease import Control
from app.people.origin import comes_from_here, is_of_this_site
from app.people.rates import Rates
from app.people.sessions import MOST_OF_ONE, Sessions
from app.people.tokens import digest
from config.errors import RefusedError


class Clock:
    now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_a_session_ends_when_nothing_is_heard_of_it(clock: Clock) -> None:
    sessions = Sessions(60.0, clock)
    key = digest(sessions.begin("ada"))
    clock.now_s += 59.0
    sessions.use(key)
    clock.now_s += 59.0
    assert sessions.token_of(key) == "ada"
    clock.now_s += 2.0
    assert sessions.token_of(key) is None
    sessions.use(key)  # too late
    assert sessions.token_of(key) is None


def test_a_session_is_ended_at_once_and_one_token_does_not_fill_the_memory(clock: Clock) -> None:
    sessions = Sessions(60.0, clock)
    first = digest(sessions.begin("ada"))
    other = digest(sessions.begin("bob"))
    for _ in range(MOST_OF_ONE):
        clock.now_s += 0.1
        last = digest(sessions.begin("ada"))
    assert (sessions.token_of(first), sessions.token_of(last), sessions.token_of(other)) == (None, "ada", "bob")
    sessions.end(other)
    assert sessions.token_of(other) is None


def test_one_has_control_until_he_does_nothing_gives_it_back_or_loses_it(clock: Clock) -> None:
    control = Control(600.0, clock)
    assert control.take("ada") is None
    with pytest.raises(RefusedError, match=r"ada has control.*10\.0 min.*take_over"):
        control.take("bob")
    clock.now_s += 599.0
    control.renew("bob")  # changes nothing
    control.renew("ada")
    clock.now_s += 599.0
    assert (control.holder, control.take("ada")) == ("ada", "ada")
    assert control.take("bob", over=True) == "ada"
    assert (control.holder, control.release("ada"), control.release("bob"), control.holder) == (
        "bob",
        False,
        True,
        None,
    )
    control.take("bob")
    clock.now_s += 601.0
    assert (control.holder, control.expires_in_s) == (None, 0.0)
    control.renew("bob")  # it is not his any more
    assert control.take("ada") is None


def test_who_asks_too_often_waits_and_others_do_not(clock: Clock) -> None:
    rates = Rates(per_s=10.0, burst=5, clock=clock)
    assert [rates.wait_s("eve") for _ in range(5)] == [0.0] * 5
    assert rates.wait_s("eve") == pytest.approx(0.1)
    assert rates.wait_s("ada") == 0.0
    clock.now_s += 0.11
    assert rates.wait_s("eve") == 0.0
    assert rates.wait_s("eve") > 0.0
    clock.now_s += 3600.0
    assert [rates.wait_s("eve") for _ in range(6)].count(0.0) == 5


def asked_by(address: str, **headers: str) -> Request:
    named = {"host": "localhost:8000", **headers}
    raw = [(name.replace("_", "-").encode(), value.encode()) for name, value in named.items()]
    return Request(
        {"type": "http", "client": (address, 5000), "headers": raw, "path": "/", "scheme": "http", "query_string": b""}
    )


@pytest.mark.parametrize(
    ("request_", "here"),
    [
        (asked_by("127.0.0.1"), True),
        (asked_by("::1", host="[::1]:8000"), True),
        (asked_by("127.0.0.1", host="127.0.0.1"), True),
        (asked_by("192.0.2.7"), False),
        (asked_by("127.0.0.1", host="rebound.example"), False),
        (asked_by("127.0.0.1", host="localhost.example:8000"), False),
        (asked_by("127.0.0.1", x_forwarded_for="127.0.0.1"), False),
        (asked_by("127.0.0.1", forwarded="for=127.0.0.1"), False),
        (asked_by("127.0.0.1", via="1.1 proxy"), False),
    ],
)
def test_who_sits_at_the_machine_is_told_from_who_only_seems_to(request_: Request, here: bool) -> None:
    assert comes_from_here(request_) is here


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
    ],
)
def test_another_sites_page_is_told_by_its_origin(host: str, origin: str, own: bool) -> None:
    assert is_of_this_site(asked_by("192.0.2.7", host=host, origin=origin)) is own


def test_a_program_says_no_origin() -> None:
    assert is_of_this_site(asked_by("192.0.2.7")) is None
