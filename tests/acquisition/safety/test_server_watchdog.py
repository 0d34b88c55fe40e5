"""When a run ends because its server is silent: never for a delay of the acquisition itself."""

from hypothesis import given
from hypothesis import strategies as st

from acquisition.safety.server_watchdog import MAX_CHECK_INTERVAL_S, ServerWatchdog

MOST_S, TURN_S, SIGN_S = 1.0, 0.005, 0.05


def silent_after_s(watch: ServerWatchdog, now_s: float, for_s: float) -> float | None:
    """Look at every turn of that time; when the first look said why a run must not go on."""
    end_s, at_s = now_s + for_s, now_s
    while at_s < end_s:
        at_s += TURN_S
        if watch.check(at_s):
            return at_s - now_s
    return None


def test_silence_ends_a_run_right_after_the_time_that_is_set():
    watch = ServerWatchdog(MOST_S)
    watch.check(100.0)
    watch.on_heartbeat()
    took_s = silent_after_s(watch, 100.0, 2.0)
    assert took_s is not None
    assert MOST_S <= took_s <= MOST_S + 2 * TURN_S
    assert "server was not heard for 1.0 s" in str(watch.check(102.0))
    watch.on_heartbeat()
    assert watch.check(102.005) is None


@given(held_up_s=st.lists(st.floats(0.0, 30.0), max_size=15))
def test_delays_of_the_acquisition_itself_are_no_silence(held_up_s: list[float]) -> None:
    """After each the server's signs wait to be read; or it was held up as well, and comes back with the next sign."""
    watch, now_s = ServerWatchdog(MOST_S), 0.0
    watch.check(now_s)
    for delay_s in held_up_s:
        now_s += delay_s
        assert watch.check(now_s) is None
        assert silent_after_s(watch, now_s, SIGN_S) is None
        now_s += SIGN_S + MAX_CHECK_INTERVAL_S
        watch.on_heartbeat()
