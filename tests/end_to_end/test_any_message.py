"""Whatever a viewer sends: it is obeyed, or the connection is closed with a reason, and nobody else notices."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from service import Service, until
from simulation import joined, simulate_raw, write_lvm
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from app.stream.viewers import LIVE_VIEWER_MESSAGE, REPLAY_VIEWER_MESSAGE

LIVE, REPLAY = "/api/live", "/api/recordings/liver.lvm/replay"
NOT_UNDERSTOOD, TOO_LONG = 1007, 1009

NUMBERS = st.floats() | st.integers(-(2**70), 2**70) | st.sampled_from([1e308, -1e308, 0, 10**400, 1e-320])
VALUES = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)
KINDS = st.sampled_from(["received", "replay", "hello", "state", ""])
NAMES = st.sampled_from(["sequence", "playing", "position_s", "speed", "by"])
CONTROLS = st.fixed_dictionaries(
    {"type": st.just("replay")},
    optional={"playing": st.booleans(), "position_s": st.floats(0, 1e308), "speed": st.floats(0.25, 10)},
)
RECEIVED = st.fixed_dictionaries({"type": st.just("received"), "sequence": st.integers(-(2**70), 2**70)})
MESSAGES = (
    (
        CONTROLS
        | RECEIVED
        | st.builds(lambda kind, rest: {"type": kind, **rest}, KINDS, st.dictionaries(NAMES, VALUES))
    ).map(json.dumps)
    | VALUES.map(json.dumps)
    | st.text(max_size=30)
    | st.binary(max_size=30)
    | st.sampled_from(["[" * 50_000, '{"a":' * 50_000, "9" * 100_000])
)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    with Service("serve") as running:
        write_lvm(running.data / "recordings" / "liver.lvm", joined(simulate_raw("liver")))
        yield running


def opened(service: Service, path: str) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{service.port}{path}", max_size=None, close_timeout=0.5)


def understood(path: str, message: str | bytes) -> bool:
    try:
        (LIVE_VIEWER_MESSAGE if path == LIVE else REPLAY_VIEWER_MESSAGE).validate_json(
            message if isinstance(message, str) else ""
        )
    except ValidationError:
        return False
    return True


def closed_with(connection: ClientConnection) -> int:
    try:
        while True:
            connection.recv(timeout=10)
    except ConnectionClosed as closed:
        assert closed.rcvd is not None, "the connection broke"
        return closed.rcvd.code


@settings(max_examples=60)
@given(path=st.sampled_from([LIVE, REPLAY]), messages=st.lists(MESSAGES, min_size=1, max_size=4))
def test_any_message_is_obeyed_or_closes_the_connection(
    service: Service, path: str, messages: list[str | bytes]
) -> None:
    with opened(service, path) as connection:
        try:
            for message in messages:
                connection.send(message)
        except ConnectionClosed:
            pass  # at the first one that was not understood
        if all(understood(path, message) for message in messages):
            assert all(connection.recv(timeout=10) for _ in range(5))
        else:
            assert closed_with(connection) in (NOT_UNDERSTOOD, TOO_LONG)


def resident_mb(service: Service) -> float:
    status = Path(f"/proc/{service.process.pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1e3


def test_viewers_who_send_without_end_take_no_memory(service: Service) -> None:
    """Answers by the thousand, and messages that are too long to be any."""
    before_mb = resident_mb(service)
    with opened(service, LIVE) as connection:
        for number in range(20_000):
            connection.send(json.dumps({"type": "received", "sequence": number}))
        assert connection.recv(timeout=10)
    for _ in range(5):
        with opened(service, LIVE) as connection:
            connection.send("x" * 2**20)
            assert closed_with(connection) == TOO_LONG
        with opened(service, LIVE) as connection, pytest.raises(ConnectionClosed):
            for _ in range(40):
                connection.send(["x" * 2**20] * 40)  # one message, in pieces
            closed_with(connection)
    assert resident_mb(service) - before_mb < 150


def test_nobody_else_noticed(service: Service) -> None:
    """The last test of this service: it ends it."""
    run = service.run(protocol="trapezoid_4hz", cycles=1, tissue="liver", by="Ada")
    assert service.finished(run["id"])["state"] == "finished"
    assert until(lambda: service.http.get("/api/health").json()["status"] == "ready")
    service.end()
    assert "Traceback" not in service.process.stderr.read()
