"""A server that hangs or dies in the midst of a grasp carries no STOP: the acquisition ends the run by itself."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from boards import ServedBoard
from sabotage import SABOTEUR
from service import Listener, Service, until

from acquisition.recordings.mcap_reader import McapFile
from app.recordings.run_reader import read_run

pytestmark = pytest.mark.alone

LONG = {"protocol": "trapezoid_025hz", "cycles": 20}
SILENCE_MS, MARGIN_MS = 1000.0, 200.0
KILLED_MS = 200.0
WHY = "the server was not heard for 1.0 s"
HANGS_S = 2.5


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedBoard]:
    with ServedBoard(tmp_path_factory.mktemp("board")) as served:
        yield served


@pytest.fixture(scope="module")
def service(board: ServedBoard) -> Iterator[Service]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(SABOTEUR))
        with Service("serve", "--tool", str(board.tool_file)) as running:
            yield running


def stop_process(pid: int) -> None:
    os.kill(pid, signal.SIGSTOP)
    threading.Timer(HANGS_S, os.kill, (pid, signal.SIGCONT)).start()


def compute(pid: int) -> None:
    os.kill(pid, signal.SIGRTMIN + 3)


@pytest.mark.parametrize("hang", [stop_process, compute])
def test_a_server_that_hangs_ends_the_run_at_zero_and_it_is_told_afterwards(
    service: Service, board: ServedBoard, hang: Callable[[int], None], reactions
) -> None:
    run = service.run(**LONG)
    board.wait_for_force()
    with Listener(service) as listener:
        struck_ns = time.monotonic_ns()
        hang(service.process.pid)
        took_ms = board.zero_after_ms(struck_ns)
        reactions.add(f"server: {hang.__name__.replace('_', ' ')}", "hold", took_ms, SILENCE_MS + MARGIN_MS)
        assert took_ms <= SILENCE_MS + MARGIN_MS
        listener.listen(lambda: any(WHY in event["text"] for event in listener.of("event")))
        listener.listen(lambda: any(WHY in alarm["text"] for alarm in listener.of("alarm")))
    ended = service.finished(run["id"])
    assert ended["state"] == "failed"
    assert WHY in ended["why"]
    assert any(WHY in line["text"] for line in service.http.get("/api/journal").json())
    path = service.data / "recordings" / f"{run['id']}.mcap"
    until(lambda: McapFile(path).complete)
    recorded = read_run(path)
    assert WHY in recorded.run.why
    assert recorded.samples["motor_command_v"][-1] == 0.0
    assert "graspwatch_lost_samples_total 0.0" in service.http.get("/metrics").text
    assert service.http.post("/api/runs", json=LONG).status_code == 409
    assert WHY in service.acknowledge_fault()
    service.run(**LONG)
    board.wait_for_force()
    service.http.post("/api/stop")


def test_a_calibration_that_moves_the_jaws_ends_as_well(service: Service, board: ServedBoard, reactions) -> None:
    answers = []
    assert service.http.post("/api/calibration", json={"what": "stretch"}).status_code in (200, 201)
    path = "/api/calibration/reading"
    reading = threading.Thread(target=lambda: answers.append(service.http.post(path, timeout=30.0)))
    reading.start()
    until(lambda: answers or board.output_v > 0.1)
    assert not answers, answers[0].text
    struck_ns = time.monotonic_ns()
    stop_process(service.process.pid)
    took_ms = board.zero_after_ms(struck_ns)
    reactions.add("server: stop process", "calibration", took_ms, SILENCE_MS + MARGIN_MS)
    assert took_ms <= SILENCE_MS + MARGIN_MS
    reading.join()
    assert answers[0].status_code >= 400
    assert WHY in answers[0].text
    service.acknowledge_fault()
