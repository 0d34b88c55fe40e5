"""The alarm book: what is on, what latches, who has seen it."""

import pytest

from app.messages.alarms import Alarm, AlarmKind
from app.stream.alarms import AlarmManager
from config.errors import RefusedError
from estimator.force_alarms import ForceAlarm, Priority

LOW, MEDIUM, HIGH = Priority.LOW, Priority.MEDIUM, Priority.HIGH
SHARE = {None: 0.1, LOW: 0.75, MEDIUM: 0.95, HIGH: 1.05}


class Room:
    """A book, and the alarms as a page would show them."""

    def __init__(self) -> None:
        self.shown: dict[str, Alarm] = {}
        self.book = AlarmManager(self._hear)

    def _hear(self, alarm: Alarm) -> None:
        if alarm.active or alarm.latched:
            self.shown[alarm.id] = alarm
        else:
            self.shown.pop(alarm.id)

    def force(self, priority: Priority | None, force_n: float | None = None) -> None:
        self.book.update_force_alarm(
            ForceAlarm(0, priority, force_n or 2.25 * SHARE[priority], 2.25, "bladder"), at_ms=1.0
        )

    def says(self) -> list[tuple[Priority, bool, str | None]]:
        """Priority, whether its cause is there, and who has acknowledged it."""
        assert list(self.shown.values()) == self.book.current_alarms()
        return [(alarm.priority, alarm.active, alarm.acknowledged_by) for alarm in self.shown.values()]

    def acknowledge(self, seen: Priority) -> None:
        worst = max(self.shown.values(), key=lambda alarm: alarm.priority is seen and alarm.acknowledged_by is None)
        self.book.acknowledge(worst.id, seen, "Ada")


@pytest.fixture
def room() -> Room:
    return Room()


@pytest.mark.parametrize("priority", [LOW, MEDIUM])
def test_a_warning_follows_its_cause(room: Room, priority: Priority) -> None:
    room.force(priority)
    assert room.says() == [(priority, True, None)]
    room.force(None)
    assert room.says() == []


@pytest.mark.parametrize("after", [None, LOW, MEDIUM])
def test_a_peak_that_nobody_has_seen_stays_and_what_comes_after_it_is_shown_too(
    room: Room, after: Priority | None
) -> None:
    room.force(HIGH)
    room.force(after)
    still = [] if after is None else [(after, True, None)]
    assert sorted(room.says()) == sorted([*still, (HIGH, False, None)])
    room.acknowledge(HIGH)
    assert room.says() == still


def test_a_peak_that_was_seen_while_it_lasted_goes_with_its_cause(room: Room) -> None:
    room.force(HIGH)
    room.acknowledge(HIGH)
    assert room.says() == [(HIGH, True, "Ada")]
    room.force(None)
    assert room.says() == []


def test_what_becomes_worse_is_a_new_alarm_to_people(room: Room) -> None:
    room.force(MEDIUM)
    [before] = room.shown.values()
    room.acknowledge(MEDIUM)
    room.force(HIGH)
    assert room.says() == [(HIGH, True, None)]
    with pytest.raises(RefusedError, match="worse by now"):
        room.book.acknowledge(before.id, MEDIUM, "Ada")
    assert room.says() == [(HIGH, True, None)]


def test_the_highest_of_several_peaks_is_the_one_to_know_of(room: Room) -> None:
    for peak_n in (2.4, 3.1, 2.6):
        room.force(HIGH, peak_n)
        room.book.update_peak_force(peak_n - 0.1)  # on its way down
        room.force(None)
    [peak] = room.shown.values()
    assert (peak.value, peak.limit, peak.unit) == (3.1, 2.25, "N")


def test_the_value_of_a_force_alarm_is_its_highest(room: Room) -> None:
    room.force(HIGH, 2.3)
    for force_n in (2.9, 2.5, None):
        room.book.update_peak_force(force_n)
    room.force(None)
    [peak] = room.shown.values()
    assert peak.value == 2.9


def test_when_nobody_tells_of_the_force_any_more_its_alarm_does_not_stay_on_but_the_peak_does(room: Room) -> None:
    room.force(HIGH)
    room.book.end_force_alarm()
    assert room.says() == [(HIGH, False, None)]


def test_what_is_over_when_it_is_told_stays_until_it_is_acknowledged(room: Room) -> None:
    room.book.raise_latched("run", AlarmKind.TECHNICAL, "The run was ended")
    assert room.says() == [(HIGH, False, None)]
    assert room.book.technical_alarm_texts() == []
    room.acknowledge(HIGH)
    assert room.says() == []
    with pytest.raises(RefusedError, match="no alarm"):
        room.book.acknowledge("run-1", HIGH, "Ada")


def test_a_technical_alarm_goes_by_itself(room: Room) -> None:
    room.book.raise_technical("samples", HIGH, "No samples")
    room.book.raise_technical("samples", HIGH, "No samples")
    assert len(room.says()) == 1
    assert room.book.technical_alarm_texts() == ["No samples"]
    room.book.end("samples")
    assert room.says() == []
