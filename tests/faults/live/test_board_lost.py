"""A board that is lost in the midst of a grasp, for a moment, for a while, and for good; the service over TCP."""

import time

import pytest
from boards import ServedBoard
from service import Listener, Service, until

pytestmark = pytest.mark.alone

LONG = {"protocol": "trapezoid_025hz", "cycles": 20}


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    with ServedBoard(tmp_path_factory.mktemp("board")) as served:
        yield served


@pytest.mark.long
@pytest.mark.parametrize("lost_s", [0.05, 2.0])
def test_a_board_that_was_lost_comes_back_at_zero_and_faulted(board, lost_s, reactions):
    with Service("serve", "--tool", str(board.tool_file)) as service, Listener(service) as listener:
        run = service.run(**LONG)
        board.wait_for_force()
        lost_ns = board.tell("be_mute", lost_s)
        took_ms = board.zero_after_ms(lost_ns)
        reactions.add(f"board: lost for {lost_s:g} s", "hold", took_ms, lost_s * 1e3 + 1000)
        assert took_ms <= lost_s * 1e3 + 1000
        listener.listen(lambda: [a for a in listener.of("alarm") if "amplifier NOW" in a["text"]])
        assert service.finished(run["id"])["state"] == "failed"
        until(service.ready)
        assert not [a for a in service.http.get("/api/alarms").json() if a["active"]]
        assert service.http.post("/api/runs", json=LONG).status_code == 409
        service.acknowledge_fault()
        service.run(**LONG)
        board.wait_for_force()
        service.http.post("/api/stop")


@pytest.mark.long
def test_a_board_that_is_lost_for_good_is_given_up_after_three_tries(board):
    with Service("serve", "--tool", str(board.tool_file)) as service:
        service.run(**LONG)
        board.wait_for_force()
        board.tell("be_mute", 3600.0)
        until(lambda: service.http.get("/api/health").json()["status"] == "faulted", 60.0)
        texts = " ".join(alarm["text"] for alarm in service.http.get("/api/alarms").json())
        assert "switch off the motor's amplifier NOW" in texts
        assert "it stays down" in texts
        time.sleep(0.5)
        assert service.http.post("/api/stop").status_code in (200, 503)
    board.tell("be_mute", 0.0)
