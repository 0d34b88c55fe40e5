"""A service that is ended in the midst of a grasp."""

import contextlib
import os
import signal
import time

import pytest
from boards import ServedBoard
from sabotage import SABOTEUR, SIGNALS
from service import Service, until
from websockets.sync.client import connect

from acquisition.recordings.mcap_reader import McapFile

pytestmark = pytest.mark.alone

LONG = {"protocol": "trapezoid_025hz", "cycles": 20}
KILLED_MS = 200.0


@pytest.mark.parametrize(
    "viewers", [pytest.param(0, id="nobody watches", marks=pytest.mark.long), pytest.param(5, id="who never read")]
)
def test_sigterm_brings_the_motor_to_zero_and_closes_the_files_within_two_seconds(
    viewers, tmp_path, monkeypatch, reactions
):
    monkeypatch.setenv("PYTHONPATH", str(SABOTEUR))
    with (
        ServedBoard(tmp_path) as board,
        Service("serve", "--tool", str(board.tool_file)) as running,
        contextlib.ExitStack() as crowd,
    ):
        for _ in range(viewers):
            crowd.enter_context(connect(running.live_url, max_size=None, max_queue=1, close_timeout=0.1))
        running.run(**LONG)
        board.wait_for_force()
        os.kill(running.process.pid, SIGNALS["fills its error output"])  # a pipe, which nobody reads
        time.sleep(1.0)
        begin_ns = time.monotonic_ns()
        running.process.send_signal(signal.SIGTERM)
        took_ms = board.zero_after_ms(begin_ns)
        running.process.wait(15)
        ended_ms = (time.monotonic_ns() - begin_ns) / 1e6
        [recording] = (running.data / "recordings").glob("*.mcap")
        assert recording.read_bytes().endswith(b"\x89MCAP0\r\n")
    reactions.add("SIGTERM: motor at zero", f"hold, {viewers} viewers", took_ms, 500.0)
    reactions.add("SIGTERM: files closed", f"hold, {viewers} viewers", ended_ms, 2e3)
    assert took_ms <= 500.0
    assert ended_ms <= 2e3


@pytest.fixture
def board(tmp_path):
    with ServedBoard(tmp_path) as served:
        yield served


def test_a_server_that_is_killed_leaves_the_motor_at_zero_and_the_next_one_says_so(board, tmp_path, reactions):
    with Service("serve", "--tool", str(board.tool_file), data=tmp_path) as service:
        run = service.run(**LONG)
        board.wait_for_force()
        struck_ns = time.monotonic_ns()
        service.process.kill()
        took_ms = board.zero_after_ms(struck_ns)
        reactions.add("server: kill -9", "hold", took_ms, KILLED_MS)
        assert took_ms <= KILLED_MS
    path = tmp_path / "recordings" / f"{run['id']}.mcap"
    until(lambda: McapFile(path).complete)
    with Service("serve", "--tool", str(board.tool_file), data=tmp_path) as service:
        found = service.http.get(f"/api/runs/{run['id']}").json()
        assert found["state"] == "failed"
        assert "ended from outside" in found["why"]
        assert board.output_v == 0.0
