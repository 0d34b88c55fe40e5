"""The tool's safety states and events, and the function for the next state; only the acquisition holds the state."""

from enum import StrEnum

from config.errors import RefusedError


class Safety(StrEnum):
    """Safety state of the tool."""

    DISARMED = "disarmed"
    TESTING = "testing"
    """The self-test of arming is under way."""
    ARMED = "armed"
    RUNNING = "running"
    LIMITING = "holding back"
    """The limiter keeps the command lower than the protocol asks for."""
    RELEASED = "let go"
    """The force passed the limit: the command is zero until the protocol's next grasp."""
    STOPPED = "stopped"
    FAULTED = "faulted"


class SafetyEvent(StrEnum):
    """Event that may change the safety state."""

    ARM = "arm"
    TEST_PASSED = "test passed"
    TEST_FAILED = "test failed"
    START = "start"
    LIMIT_FORCE = "hold back"
    RELEASE_GRASP = "let go"
    RESUME = "release"
    """The limiter no longer lowers the command."""
    FINISH = "finish"
    STOP = "stop"
    FAULT = "fault"
    ACKNOWLEDGE = "acknowledge"
    DISARM = "disarm"


MOTOR_ACTIVE_STATES = frozenset({Safety.RUNNING, Safety.LIMITING})
"""States in which the motor may move."""

RUN_STATES = MOTOR_ACTIVE_STATES | {Safety.RELEASED}
MONITORED_STATES = RUN_STATES | {Safety.ARMED}
"""States in which a lost signal is a fault; in the others the self-test finds it."""

_RUN_TRANSITIONS = {
    SafetyEvent.LIMIT_FORCE: Safety.LIMITING,
    SafetyEvent.RELEASE_GRASP: Safety.RELEASED,
    SafetyEvent.RESUME: Safety.RUNNING,
    SafetyEvent.FINISH: Safety.ARMED,
}
_TRANSITIONS = {
    Safety.DISARMED: {SafetyEvent.ARM: Safety.TESTING, SafetyEvent.STOP: Safety.DISARMED},
    Safety.TESTING: {SafetyEvent.TEST_PASSED: Safety.ARMED, SafetyEvent.TEST_FAILED: Safety.DISARMED},
    Safety.ARMED: {SafetyEvent.ARM: Safety.ARMED, SafetyEvent.START: Safety.RUNNING},
    Safety.RUNNING: _RUN_TRANSITIONS,
    Safety.LIMITING: _RUN_TRANSITIONS,
    Safety.RELEASED: _RUN_TRANSITIONS,
    Safety.STOPPED: {SafetyEvent.ARM: Safety.TESTING},
    Safety.FAULTED: {
        SafetyEvent.STOP: Safety.FAULTED,
        SafetyEvent.DISARM: Safety.FAULTED,
        SafetyEvent.ACKNOWLEDGE: Safety.DISARMED,
    },
}
_TRANSITIONS_FROM_ANY = {
    SafetyEvent.STOP: Safety.STOPPED,
    SafetyEvent.FAULT: Safety.FAULTED,
    SafetyEvent.DISARM: Safety.DISARMED,
}

_REFUSAL_TEXTS = {
    Safety.DISARMED: "The tool is not armed: arm it first.",
    Safety.TESTING: "The self-test is under way: wait for its end.",
    Safety.ARMED: "The tool is armed, but nothing runs.",
    Safety.STOPPED: "The tool was stopped: arm it again first.",
    Safety.FAULTED: "A fault is latched: acknowledge it first.",
}


def next_state(state: Safety, event: SafetyEvent) -> Safety:
    """Return the state that follows.

    Raises:
        RefusedError: the event is not allowed in this state; the text says what has to happen first.
    """
    following = _TRANSITIONS[state].get(event) or _TRANSITIONS_FROM_ANY.get(event)
    if following:
        return following
    if event is SafetyEvent.ACKNOWLEDGE:
        raise RefusedError("No fault is latched: there is nothing to acknowledge.")
    raise RefusedError(_REFUSAL_TEXTS.get(state, "A run is under way. Stop it first."))
