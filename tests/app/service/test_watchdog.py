"""Silence of workers: told, and ended where it lasts, but never for what a predecessor owed."""

import time
from dataclasses import dataclass, field

import pytest

from app.service import watchdog
from app.service.watchdog import Watchdog
from app.service.workers import WorkerCondition
from app.stream.alarms import AlarmManager


@dataclass
class Named:
    condition: WorkerCondition = WorkerCondition.RUNNING


@dataclass
class Workers:
    """As much of a supervisor as a watchdog sees."""

    workers: dict[str, Named] = field(
        default_factory=lambda: {name: Named() for name in ("acquisition", "estimator", "recorder", "guard")}
    )
    killed: list[str] = field(default_factory=list)
    held_up: set[str] = field(default_factory=set)
    replaced: set[str] = field(default_factory=set)
    idle_starts: set[str] = field(default_factory=set)

    def is_being_replaced(self, name: str) -> bool:
        return name in self.replaced

    def is_kept_from_running(self, name: str) -> bool:
        return name in self.held_up

    def is_idle_start(self, name: str) -> bool:
        return name in self.idle_starts

    def kill(self, name: str) -> None:
        self.killed.append(name)


def watch_for(dog: Watchdog, seconds: float, *speaking: str) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        for name in speaking:
            dog.feed(name)
        dog.check()
        time.sleep(0.01)


@pytest.fixture
def workers(monkeypatch: pytest.MonkeyPatch) -> Workers:
    monkeypatch.setattr(watchdog, "HUNG_TIMEOUT_S", 0.5)
    return Workers()


def test_an_estimator_that_hangs_is_ended(workers: Workers) -> None:
    dog = Watchdog(workers, AlarmManager(lambda message: None), lambda text: None)
    watch_for(dog, 0.1, "acquisition", "estimator")
    watch_for(dog, 0.6, "acquisition")
    assert "estimator" in workers.killed


def test_a_worker_that_cannot_run_is_told_and_ended_only_after_a_minute(
    workers: Workers, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watchdog, "MAX_KEPT_FROM_RUNNING_S", 1.0)
    alarms = AlarmManager(lambda message: None)
    dog = Watchdog(workers, alarms, lambda text: None)
    watch_for(dog, 0.1, "acquisition", "estimator")
    workers.held_up.add("estimator")
    watch_for(dog, 1.0, "acquisition")
    assert [alarm.text for alarm in alarms.current_alarms()] == ["No estimates arrive: the tissue is not watched"]
    assert workers.killed == []
    watch_for(dog, 1.2, "acquisition")
    assert "estimator" in workers.killed


def test_a_new_estimator_is_not_ended_for_the_silence_of_the_one_before(workers: Workers) -> None:
    dog = Watchdog(workers, AlarmManager(lambda message: None), lambda text: None)
    watch_for(dog, 0.1, "acquisition", "estimator")
    workers.workers["estimator"].condition = WorkerCondition.STARTING
    watch_for(dog, 0.6, "acquisition")
    workers.workers["estimator"].condition = WorkerCondition.RUNNING
    dog.on_estimator_started()
    watch_for(dog, 0.1, "acquisition")
    assert not workers.killed
    watch_for(dog, 0.6, "acquisition")
    assert "estimator" in workers.killed


def test_what_waits_to_be_read_is_no_silence(workers: Workers) -> None:
    told: list[str] = []
    dog = Watchdog(workers, AlarmManager(lambda message: told.append(message.text)), lambda text: None)
    watch_for(dog, 0.1, "acquisition", "estimator", "recorder", "guard")
    time.sleep(0.4)  # the server is held up; the workers go on
    dog.check(own_delay_s=0.4)
    assert not told
    watch_for(dog, 0.5)
    assert {
        "No samples arrive from the tool",
        "The recorder does not answer: nothing is recorded",
        "The safety monitor does not answer: a hung acquisition would be noticed late",
    } <= {*told}


def test_an_acquisition_that_waits_for_its_device_is_told_and_never_ended(workers: Workers) -> None:
    alarms = AlarmManager(lambda message: None)
    dog = Watchdog(workers, alarms, lambda text: None)
    end_s = time.monotonic() + 1.0
    while time.monotonic() < end_s:
        dog.on_waiting_for_samples("the port is gone: plug it in")
        watch_for(dog, 0.02)
    told = "No samples arrive from the tool: the port is gone: plug it in"
    assert [alarm.text for alarm in alarms.current_alarms()] == [told]
    assert workers.killed == []
    watch_for(dog, 0.2, "acquisition", "estimator")
    assert alarms.current_alarms() == []


def test_a_planned_replacement_of_an_acquisition_that_has_waited_is_no_silence(workers: Workers) -> None:
    alarms = AlarmManager(lambda message: None)
    dog = Watchdog(workers, alarms, lambda text: None)
    dog.on_waiting_for_samples("the port is gone: plug it in")
    watch_for(dog, 0.1, "acquisition", "estimator")
    dog.forget("acquisition")
    workers.workers["acquisition"].condition = WorkerCondition.STARTING
    watch_for(dog, 0.5)
    assert alarms.current_alarms() == []


def test_a_worker_that_is_replaced_may_speak_until_it_ends_and_owes_nothing(workers: Workers) -> None:
    alarms = AlarmManager(lambda message: None)
    dog = Watchdog(workers, alarms, lambda text: None)
    watch_for(dog, 0.1, "acquisition", "estimator")
    for name in ("acquisition", "estimator"):
        dog.forget(name)
        workers.workers[name].condition = WorkerCondition.STARTING
        workers.replaced.add(name)
    watch_for(dog, 0.1, "acquisition", "estimator")  # they have not ended yet
    dog.on_waiting_for_samples("the port is gone: plug it in")
    watch_for(dog, 0.6)
    assert (alarms.current_alarms(), workers.killed) == ([], [])
    workers.replaced.clear()
    watch_for(dog, 0.1, "acquisition", "estimator")
    watch_for(dog, 0.6)
    assert "No samples arrive from the tool" in [alarm.text for alarm in alarms.current_alarms()]


def test_a_worker_that_hangs_while_it_starts_is_ended_and_one_that_computes_is_not(
    workers: Workers, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watchdog, "HUNG_START_TIMEOUT_S", 0.5)
    dog = Watchdog(workers, AlarmManager(lambda message: None), lambda text: None)
    for name in ("estimator", "recorder"):
        workers.workers[name].condition = WorkerCondition.STARTING
    workers.idle_starts.add("recorder")
    watch_for(dog, 0.4, "acquisition")
    assert workers.killed == []
    watch_for(dog, 0.4, "acquisition")
    assert workers.killed == ["recorder"]
