"""Which command was on at each sample: whatever the reader and the machine do, the bounds hold the truth."""

import math
from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st

from acquisition.drivers.command_history import AppliedCommand, CommandHistory, SampleCountReading

RATE_HZ = 1000.0
PERIOD_NS = 1_000_000


@dataclass
class Board:
    """Samples are taken at whole milliseconds after `started_ns`; a command is on from the moment of its write."""

    started_ns: int
    now_ns: int

    def taken(self) -> int:
        return (self.now_ns - self.started_ns) // PERIOD_NS

    def tick_ns(self, tick: int) -> int:
        """When the sample was taken."""
        return self.started_ns + (tick + 1) * PERIOD_NS


SPAN_NS = st.one_of(st.integers(0, 400_000), st.integers(0, 500 * PERIOD_NS))  # prompt, or held up for up to 0.5 s
TURN = st.tuples(SPAN_NS, SPAN_NS, SPAN_NS, SPAN_NS, SPAN_NS, st.floats(0.0, 3.5))


@given(offset_ns=st.integers(0, PERIOD_NS), lag=st.integers(0, 500), turns=st.lists(TURN, min_size=1, max_size=60))
def test_the_bounds_hold_the_command_that_was_on(offset_ns: int, lag: int, turns: list[tuple]) -> None:
    """Each turn: ask the board for its count, wait, write, wait; five samples a turn are judged, `lag` or more late."""
    board = Board(started_ns=0, now_ns=offset_ns + lag * PERIOD_NS)
    history, written_ns = CommandHistory(), [(-1, 0.0)]
    next_tick = 0
    for before_ns, answer_ns, wait_ns, write_ns, done_ns, command_v in turns:
        asked_ns = board.now_ns
        board.now_ns += before_ns
        taken = board.taken()
        board.now_ns += answer_ns
        count = SampleCountReading(RATE_HZ, asked_ns, board.now_ns, taken)  # the board is asked at every turn
        if next_tick + 5 <= taken:
            commands = history.compute_bounds(next_tick, 5)
            truth = [
                next(volts for at_ns, volts in reversed(written_ns) if at_ns < board.tick_ns(tick))
                for tick in range(next_tick, next_tick + 5)
            ]
            for low_v, true_v, high_v in zip(commands.low_v, truth, commands.high_v, strict=True):
                assert low_v <= true_v <= high_v
            assert not any(commands.compute_deviations_v(truth))
            next_tick += 5
        board.now_ns += wait_ns
        begin_ns = board.now_ns
        board.now_ns += write_ns
        written_ns.append((board.now_ns, command_v))
        board.now_ns += done_ns
        history.append(
            AppliedCommand(command_v, count.min_count_at(begin_ns), count.max_count_at(board.now_ns)), flags=0
        )


@given(lag=st.integers(0, 500), volts=st.lists(st.floats(0.0, 3.5), min_size=1, max_size=50))
def test_a_reader_that_only_lags_leaves_nothing_unknown(lag: int, volts: list[float]) -> None:
    """Questions and writes that take no time: each sample has one command, however late it is read."""
    history, truth = CommandHistory(), [0.0] * lag
    for turn, command_v in enumerate(volts):
        taken = lag + 5 * turn
        count = SampleCountReading(RATE_HZ, taken * PERIOD_NS, taken * PERIOD_NS, taken)
        history.append(
            AppliedCommand(command_v, count.min_count_at(taken * PERIOD_NS), count.max_count_at(taken * PERIOD_NS)),
            flags=turn,
        )
        truth += [command_v] * 5
        read = history.compute_bounds(5 * turn, 5)
        assert read.low_v == read.high_v == read.likely_v == truth[5 * turn : 5 * turn + 5]


def test_a_read_back_beyond_the_bounds_is_told_by_how_much() -> None:
    history = CommandHistory()
    history.append(AppliedCommand(1.0, 2, 4), flags=0)
    commands = history.compute_bounds(0, 5)
    assert commands.compute_deviations_v([0.0, 0.5, 0.5, 1.25, 0.5]) == [0.0, 0.5, 0.0, 0.25, 0.5]
    assert commands.compute_deviations_v([math.nan] * 5) == [math.inf] * 5
