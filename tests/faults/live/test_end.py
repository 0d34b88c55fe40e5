"""A service that is ended in the midst of a grasp."""

import signal
import time

from boards import ServedBoard
from service import Service, until

LONG = {"protocol": "trapezoid_025hz", "cycles": 20}


def test_sigterm_brings_the_motor_to_zero_and_closes_the_files_within_two_seconds(tmp_path, reactions):
    with ServedBoard(tmp_path) as board, Service("serve", "--tool", str(board.tool_file)) as running:
        until(lambda: running.http.get("/api/health").json()["workers"]["guard"] == "running")
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
    reactions.add("SIGTERM: motor at zero", "hold", took_ms, 2e3)
    reactions.add("SIGTERM: files closed", "hold", ended_ms, 2e3)
    assert took_ms <= 2e3
    assert ended_ms <= 2e3
