"""A service that is ended in the midst of a grasp."""

import contextlib
import signal
import time

import pytest
from boards import ServedBoard
from service import Service
from websockets.sync.client import connect

pytestmark = pytest.mark.alone

LONG = {"protocol": "trapezoid_025hz", "cycles": 20}


@pytest.mark.parametrize(
    "viewers", [pytest.param(0, id="nobody watches", marks=pytest.mark.long), pytest.param(5, id="who never read")]
)
def test_sigterm_brings_the_motor_to_zero_and_closes_the_files_within_two_seconds(viewers, tmp_path, reactions):
    with (
        ServedBoard(tmp_path) as board,
        Service("serve", "--tool", str(board.tool_file)) as running,
        contextlib.ExitStack() as crowd,
    ):
        for _ in range(viewers):
            crowd.enter_context(connect(running.live_url, max_size=None, max_queue=1, close_timeout=0.1))
        running.run(**LONG)
        board.wait_for_force()
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
