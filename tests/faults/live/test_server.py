"""A server that is overrun, held up or full of viewers: the tool does not notice."""

import asyncio
import contextlib
import os
import signal
import threading
import time

import httpx
import pytest
from boards import ServedBoard
from sabotage import SABOTEUR, SIGNALS
from service import Listener, Service, until
from websockets.asyncio.client import connect

pytestmark = pytest.mark.alone

VIEWERS, WHO_NEVER_READ = 100, 10
STORM_REQUESTS, STORM_CLIENTS = 500, 20
STOP_S = 0.5
LONG = {"protocol": "trapezoid_025hz", "cycles": 20}


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    with ServedBoard(tmp_path_factory.mktemp("board")) as served:
        yield served


@pytest.fixture(scope="module")
def service(board):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(SABOTEUR))
        with Service("serve", "--tool", str(board.tool_file)) as running:
            yield running


async def _watch(url: str, seconds: float, *, reads: bool) -> int:
    """A viewer for a while; how many messages it got."""
    received = 0
    async with connect(url, max_size=None, max_queue=1, close_timeout=0.2) as socket:
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            if not reads:
                await asyncio.sleep(left)
                break
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(socket.recv(), left)
                received += 1
    return received


async def _crowd(url: str, seconds: float) -> list[int]:
    watchers = [_watch(url, seconds, reads=i >= WHO_NEVER_READ) for i in range(VIEWERS)]
    return await asyncio.gather(*watchers)


def stop_took_ms(service, board) -> float:
    begin_ns = time.monotonic_ns()
    assert service.http.post("/api/stop").status_code == 200
    return board.zero_after_ms(begin_ns)


@pytest.mark.long
def test_a_hundred_viewers_of_which_ten_never_read_lose_no_sample_and_stop_works(service, board, reactions):
    run = service.run(**LONG)
    board.wait_for_force()
    crowd: list[int] = []
    thread = threading.Thread(target=lambda: crowd.extend(asyncio.run(_crowd(service.live_url, 6.0))))
    thread.start()
    time.sleep(4.0)
    took_ms = stop_took_ms(service, board)
    thread.join()
    reactions.add("server: 100 viewers, 10 never read: STOP", "hold", took_ms, STOP_S * 1e3)
    assert took_ms <= STOP_S * 1e3
    assert min(crowd[WHO_NEVER_READ:]) > 30
    ended = service.http.get(f"/api/runs/{run['id']}").json()
    assert (ended["state"], ended["why"]) == ("stopped", "asked to stop")
    assert "graspwatch_lost_samples_total 0.0" in service.http.get("/metrics").text


def test_a_storm_of_requests_delays_neither_the_tool_nor_stop(service, board, reactions):
    service.run(**LONG)
    board.wait_for_force()
    answers: list[int] = []

    def ask() -> None:
        with httpx.Client(base_url=service.url, timeout=30.0) as client:
            answers.extend(client.get("/api/protocols").status_code for _ in range(STORM_REQUESTS // STORM_CLIENTS))

    clients = [threading.Thread(target=ask) for _ in range(STORM_CLIENTS)]
    for client in clients:
        client.start()
    time.sleep(1.0)
    took_ms = stop_took_ms(service, board)
    for client in clients:
        client.join()
    reactions.add("server: request storm: STOP", "hold", took_ms, 2e3)
    assert took_ms <= 2e3
    assert {*answers} <= {200, 429}
    assert "graspwatch_lost_samples_total 0.0" in service.http.get("/metrics").text


def test_an_error_output_that_nobody_reads_holds_nobody_up(service, board):
    """Its pipe holds 64 kB; a paused terminal does the same."""
    service.run(**LONG)
    board.wait_for_force()
    os.kill(service.process.pid, SIGNALS["fills its error output"])
    assert stop_took_ms(service, board) <= STOP_S * 1e3


def stop_process(pid):
    os.kill(pid, signal.SIGSTOP)
    time.sleep(0.6)
    os.kill(pid, signal.SIGCONT)


def block_event_loop(pid):
    os.kill(pid, signal.SIGRTMIN)
    time.sleep(0.6)


@pytest.mark.parametrize("hold_up", [pytest.param(stop_process, marks=pytest.mark.long), block_event_loop])
def test_a_server_that_is_held_up_for_less_than_a_second_leaves_the_tool_alone(service, board, hold_up):
    run = service.run(**LONG)
    board.wait_for_force()
    workers = {name: service.worker(name) for name in ("acquisition", "estimator", "recorder", "guard")}
    hold_up(service.process.pid)
    with Listener(service) as listener:
        listener.listen(lambda: len(listener.of("state")) > 3)
        assert not [alarm["text"] for alarm in listener.of("alarm") if alarm["kind"] == "technical"]
    assert service.http.get(f"/api/runs/{run['id']}").json()["state"] == "running"
    assert {name: service.worker(name) for name in workers} == workers
    assert "graspwatch_lost_samples_total 0.0" in service.http.get("/metrics").text
    service.http.post("/api/stop")


def test_a_hung_acquisition_is_brought_to_zero_even_while_the_server_is_held_up(service, board, reactions):
    run = service.run(**LONG)
    board.wait_for_force()
    acquisition = service.worker("acquisition")
    os.kill(service.process.pid, signal.SIGSTOP)
    try:
        struck_ns = time.monotonic_ns()
        os.kill(acquisition, SIGNALS["hangs"])
        took_ms = board.zero_after_ms(struck_ns)
    finally:
        os.kill(service.process.pid, signal.SIGCONT)
    reactions.add("acquisition hangs, server stopped", "hold", took_ms, 100.0)
    assert took_ms <= 100.0
    assert service.finished(run["id"])["state"] == "failed"
    until(service.ready)
    service.acknowledge_fault()
