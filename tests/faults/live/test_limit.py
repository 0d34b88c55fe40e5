"""The limit that is shown is the one that the limiter enforces: in the stream, in the state, and in the recording."""

import json
import os
import signal
import time

import numpy as np
import pytest
from boards import ServedBoard
from service import Listener, Service, until

from acquisition.recordings.mcap_reader import McapFile
from acquisition.safety.force_limiter import ForceLimiter
from app.recordings.run_reader import read_run
from config.load import load_library, load_settings, load_tool

pytestmark = pytest.mark.alone  # a reaction time is judged
LIBRARY, SETTINGS = load_library("porcine"), load_settings()
MARGIN = SETTINGS.limiter.margin
LOWEST_N, LIVER_N = MARGIN * LIBRARY.lowest_threshold_n, MARGIN * LIBRARY.threshold_n("liver")
BLOCK = 5
FALLEN_MS = 110.0  # by the board's clock: a threshold counts for 100 ms, and the limiter judges block by block


@pytest.fixture
def board(tmp_path):
    with ServedBoard(tmp_path, tissue="liver", seed=3) as served:
        yield served


def test_the_limit_in_stream_and_file_is_the_limiters_own_also_while_it_rises_and_without_an_estimator(
    board, tmp_path, monkeypatch, reactions
):
    log = tmp_path / "limits.jsonl"
    monkeypatch.setenv("LIMIT_LOG", str(log))
    monkeypatch.setenv("PYTHONPATH", os.path.join(os.path.dirname(__file__), "limit_log"))
    with Service("serve", "--tool", str(board.tool_file)) as service, Listener(service) as listener:
        listener.listen(lambda: listener.frames)
        column = [channel["name"] for channel in listener.of("hello")[0]["channels"]].index("limit_n")
        assert listener.frames[-1][1][column, -1] == np.float32(LOWEST_N), "at rest"
        run = service.run(protocol="strong_2hz", cycles=40)
        listener.listen(lambda: listener.frames[-1][1][column, -1] > 1.1 * LOWEST_N, 30.0)
        os.kill(service.worker("estimator"), signal.SIGKILL)
        listener.listen(lambda: listener.frames[-1][1][column, -1] == np.float32(LOWEST_N))
        state = listener.of("state")
        board.wait_for_force()  # the next grasp, under the lowest limit
        time.sleep(0.5)
        service.http.post("/api/stop")
        listener.listen(lambda: listener.of("state")[-1]["run"] is None)
        frames = list(listener.frames)
        recorded = until(lambda: whole(service.data, run["id"]))
    assert all(LOWEST_N <= each["limit_n"] <= LIVER_N for each in state[1:])
    enforced, told = _recomputed(log, recorded)
    told = [tick for tick in told if tick >= min(enforced)]
    last = told[int(np.argmax(np.diff([*told, max(enforced)])))]  # before the estimator died
    fallen_ms = min(tick for tick, limit_n in enforced.items() if tick > last and limit_n == LOWEST_N) - last
    reactions.add("limit: estimator killed: lowest limit", "grasp", fallen_ms, FALLEN_MS)
    assert fallen_ms <= FALLEN_MS
    assert {LOWEST_N} < {*enforced.values()}, "it was told another one"
    rising = [value for value in enforced.values() if LOWEST_N < value < LIVER_N]
    assert len({*rising}) > 10, "it rose by and by"
    streamed = {
        int(header[6]) + i: value for header, columns in frames for i, value in enumerate(columns[column].tolist())
    }
    shown = set()  # frames are left out while nobody reads them: those that came must show the rise and the fall
    for first, limit_n in enforced.items():
        taken = recorded.samples[np.searchsorted(recorded.samples["tick"], first) :][:BLOCK]
        np.testing.assert_array_equal(taken["limit_n"], limit_n)
        there = [streamed[tick] for tick in range(first, first + BLOCK) if tick in streamed]
        assert {*there} <= {float(np.float32(limit_n))}
        shown |= {limit_n} if there else set()
    assert LOWEST_N in shown
    assert len(shown & {*rising}) > 10, "the stream showed it rising"


def _recomputed(log, recorded):
    """Return each block's limit by its first tick, and the ticks at which a threshold arrived.

    The limit is that of a limiter of our own, which receives the same messages; the service's own agrees.
    """
    limiter = ForceLimiter(load_tool("simulated"), LIBRARY, SETTINGS.limiter)
    samples, enforced, told = recorded.samples, {}, []
    for line in log.read_text().splitlines():
        match json.loads(line):
            case ["threshold", threshold_n, tick]:
                limiter.set_threshold(threshold_n, tick)
                told.append(tick)
            case ["command", first, commands_v, wanted_v, limit_n]:
                at = int(np.searchsorted(samples["tick"], first))
                limiter.limit_command(samples[at : at + BLOCK], commands_v, wanted_v)
                assert limiter.limit_n == limit_n
                enforced[first + BLOCK] = limit_n
    return enforced, told


def whole(data, run_id):
    """The recording of a run, once it is closed."""
    path = data / "recordings" / f"{run_id}.mcap"
    return read_run(path) if path.exists() and McapFile(path).complete else None
