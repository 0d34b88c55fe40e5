"""The state machine: every state with every event."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.safety_state_machine import MOTOR_ACTIVE_STATES, Safety, SafetyEvent, next_state
from config.errors import RefusedError

TABLE = """
               disarmed testing  armed    running      holding back let go       stopped  faulted
arm            testing  no       armed    no           no           no           testing  no
test passed    no       armed    no       no           no           no           no       no
test failed    no       disarmed no       no           no           no           no       no
start          no       no       running  no           no           no           no       no
hold back      no       no       no       holding back holding back holding back no       no
let go         no       no       no       let go       let go       let go       no       no
release        no       no       no       running      running      running      no       no
finish         no       no       no       armed        armed        armed        no       no
stop           disarmed stopped  stopped  stopped      stopped      stopped      stopped  faulted
fault          faulted  faulted  faulted  faulted      faulted      faulted      faulted  faulted
acknowledge    no       no       no       no           no           no           no       disarmed
disarm         disarmed disarmed disarmed disarmed     disarmed     disarmed     disarmed faulted
"""
HEAD, *ROWS = TABLE.strip("\n").splitlines()
EDGES = [15, 24, 33, 42, 55, 68, 81, 90, None]
COLUMNS = [slice(begin, end) for begin, end in pairwise(EDGES)]
EXPECTED = {
    (Safety(HEAD[column].strip()), SafetyEvent(row[:15].strip())): row[column].strip()
    for row in ROWS
    for column in COLUMNS
}


def test_the_table_is_whole():
    assert set(EXPECTED) == {(state, event) for state in Safety for event in SafetyEvent}


@pytest.mark.parametrize(("state", "event"), EXPECTED, ids=str)
def test_every_state_with_every_event(state, event):
    expected = EXPECTED[state, event]
    if expected == "no":
        with pytest.raises(RefusedError):
            next_state(state, event)
    else:
        assert next_state(state, event) is Safety(expected)


@given(st.lists(st.sampled_from(SafetyEvent), max_size=40))
def test_nothing_but_a_passed_test_and_a_start_makes_the_motor_move_and_a_fault_stays(events):
    state, tested = Safety.DISARMED, False
    for event in events:
        before = state
        try:
            state = next_state(state, event)
        except RefusedError:
            assert state is before
            continue
        if event is SafetyEvent.TEST_PASSED:
            tested = True
        elif event in (SafetyEvent.STOP, SafetyEvent.DISARM, SafetyEvent.FAULT):
            tested = False
            assert state not in MOTOR_ACTIVE_STATES
        if state in MOTOR_ACTIVE_STATES:
            assert tested
        if before is Safety.FAULTED and event is not SafetyEvent.ACKNOWLEDGE:
            assert state is Safety.FAULTED
