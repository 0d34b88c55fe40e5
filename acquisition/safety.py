"""Whether the motor may move: one pure state machine, kept by the acquisition worker, who alone commands the motor."""

from enum import StrEnum

from config.errors import RefusedError


class Safety(StrEnum):
    """Where the tool stands."""

    DISARMED = "disarmed"
    TESTING = "testing"
    """The self-test of arming is under way."""
    ARMED = "armed"
    RUNNING = "running"
    HOLDING_BACK = "holding back"
    """The limiter keeps the command lower than the protocol asks for."""
    LET_GO = "let go"
    """The force passed the limit: no command until the protocol's next grasp."""
    STOPPED = "stopped"
    FAULTED = "faulted"


class Event(StrEnum):
    """What happens to it."""

    ARM = "arm"
    TEST_PASSED = "test passed"
    TEST_FAILED = "test failed"
    START = "start"
    HOLD_BACK = "hold back"
    LET_GO = "let go"
    RELEASE = "release"
    """The limiter has no objection any more."""
    FINISH = "finish"
    STOP = "stop"
    FAULT = "fault"
    ACKNOWLEDGE = "acknowledge"
    DISARM = "disarm"


MOVING = frozenset({Safety.RUNNING, Safety.HOLDING_BACK})
"""The motor moves in no other state."""

IN_RUN = MOVING | {Safety.LET_GO}
WATCHED = IN_RUN | {Safety.ARMED}
"""A lost signal is a fault in these; in others the self-test will find it."""

_IN_RUN = {
    Event.HOLD_BACK: Safety.HOLDING_BACK,
    Event.LET_GO: Safety.LET_GO,
    Event.RELEASE: Safety.RUNNING,
    Event.FINISH: Safety.ARMED,
}
_FROM = {
    Safety.DISARMED: {Event.ARM: Safety.TESTING, Event.STOP: Safety.DISARMED},
    Safety.TESTING: {Event.TEST_PASSED: Safety.ARMED, Event.TEST_FAILED: Safety.DISARMED},
    Safety.ARMED: {Event.ARM: Safety.ARMED, Event.START: Safety.RUNNING},
    Safety.RUNNING: _IN_RUN,
    Safety.HOLDING_BACK: _IN_RUN,
    Safety.LET_GO: _IN_RUN,
    Safety.STOPPED: {Event.ARM: Safety.TESTING},
    Safety.FAULTED: {Event.STOP: Safety.FAULTED, Event.DISARM: Safety.FAULTED, Event.ACKNOWLEDGE: Safety.DISARMED},
}
_FROM_ANY = {Event.STOP: Safety.STOPPED, Event.FAULT: Safety.FAULTED, Event.DISARM: Safety.DISARMED}

_REFUSALS = {
    Safety.DISARMED: "The tool is not armed: arm it first.",
    Safety.TESTING: "The self-test is under way: wait for its end.",
    Safety.ARMED: "The tool is armed, but nothing runs.",
    Safety.STOPPED: "The tool was stopped: arm it again first.",
    Safety.FAULTED: "A fault is latched: acknowledge it first.",
}


def after(state: Safety, event: Event) -> Safety:
    """The state that follows.

    Raises:
        RefusedError: the event cannot happen in this state; the text says what has to happen first.
    """
    following = _FROM[state].get(event) or _FROM_ANY.get(event)
    if following:
        return following
    if event is Event.ACKNOWLEDGE:
        raise RefusedError("No fault is latched: there is nothing to acknowledge.")
    raise RefusedError(_REFUSALS.get(state, "A run is under way. Stop it first."))
