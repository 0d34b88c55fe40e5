"""The class Watchdog: raises a technical alarm while a worker is silent, and kills a worker that hangs."""

import time
from collections.abc import Callable

from app.service.supervisor import Supervisor
from app.service.workers import WorkerCondition, display_worker_name
from app.stream.alarms import AlarmManager
from estimator.force_alarms import Priority

SILENCE_ALARM_S = 0.35  # the alarm is promised within 0.5 s
HUNG_TIMEOUT_S = 2.0  # a worker silent for longer is killed and replaced
RECORDER_HUNG_TIMEOUT_S = 10.0  # longer, because a disk may be slow
SAFETY_MONITOR_HUNG_TIMEOUT_S = 2.0
HUNG_START_TIMEOUT_S = 20.0
"""Time that a starting estimator or recorder may sleep; compiling keeps it busy. The others may wait for the board."""
MAX_KEPT_FROM_RUNNING_S = 60.0
"""Time that a worker may be stopped or swapped out before it is killed: the bus keeps a minute of blocks for it."""


class Watchdog:
    """A monitor of the workers' silence, judged by the messages that arrive.

    Only time in which this process could listen counts as silence. After a stop of the whole machine, messages still
    wait to be read, and the workers need time to resume.
    """

    def __init__(self, supervisor: Supervisor, alarms: AlarmManager, publish_event: Callable[[str], None]) -> None:
        self._supervisor = supervisor
        self._alarms = alarms
        self._publish_event = publish_event
        self._last_heard_s = {"acquisition": 0.0, "estimator": 0.0, "recorder": 0.0, "guard": 0.0}
        self._own_delay_s = 0.0  # total time in which this process could not listen
        self._last_check_s = time.monotonic()
        self._kept_from_running_s: dict[str, float] = {}  # by worker: part of its silence
        self._idle_start_s = dict.fromkeys(("estimator", "recorder"), 0.0)
        self._sampling_since_s = self._estimating_since_s = 0.0
        self._waiting_heard_s, self._waiting_why = 0.0, ""  # of an acquisition that waits for its device
        self.is_sampling = False

    def _listening_time_s(self) -> float:
        return time.monotonic() - self._own_delay_s

    def feed(self, worker: str) -> None:
        """Take note of a message from a worker, unless it is being replaced: its messages no longer count."""
        if self._supervisor.is_being_replaced(worker):
            return
        self._last_heard_s[worker] = self._listening_time_s()
        self._kept_from_running_s.pop(worker, None)

    def on_waiting_for_samples(self, why: str) -> None:
        """Take note that the acquisition runs, but its device gives no samples; `why` says what to do."""
        if self._supervisor.is_being_replaced("acquisition"):
            return
        self._waiting_heard_s, self._waiting_why = self._listening_time_s(), why
        self._kept_from_running_s.pop("acquisition", None)

    def forget(self, worker: str) -> None:
        """Expect nothing of a worker that is replaced until the new one sends its first message."""
        self._last_heard_s[worker] = 0.0
        self._kept_from_running_s.pop(worker, None)
        if worker == "acquisition":
            self._waiting_heard_s = 0.0

    def on_estimator_started(self) -> None:
        """Start the estimator's silence anew, so that a new process does not inherit its predecessor's."""
        self._estimating_since_s = self._listening_time_s()
        self._kept_from_running_s.pop("estimator", None)

    def check(self, own_delay_s: float = 0.0) -> None:
        """Raise an alarm for each silent worker, end the alarms of the others, and kill workers that hang.

        `own_delay_s`: time since the last check in which this process could not listen.
        """
        self._own_delay_s += own_delay_s
        now = self._listening_time_s()
        since_last_s, self._last_check_s = now - self._last_check_s, now
        alive = {name: worker.condition is WorkerCondition.RUNNING for name, worker in self._supervisor.workers.items()}
        before, self.is_sampling = self.is_sampling, now - self._last_heard_s["acquisition"] < SILENCE_ALARM_S
        if not before:
            self._sampling_since_s = now  # before, the estimator had no samples to answer
        silent_s = {
            "acquisition": now - max(self._last_heard_s["acquisition"], self._waiting_heard_s),
            "estimator": now - max(self._last_heard_s["estimator"], self._sampling_since_s, self._estimating_since_s),
        }
        estimating = now - self._last_heard_s["estimator"] < SILENCE_ALARM_S
        if (self._last_heard_s["acquisition"] or self._waiting_heard_s) and not self.is_sampling:
            is_waiting = now - self._waiting_heard_s < SILENCE_ALARM_S
            why = f": {self._waiting_why}" if is_waiting and self._waiting_why else ""
            self._alarms.raise_technical("samples", Priority.HIGH, f"No samples arrive from the tool{why}")
        elif self.is_sampling and alive["acquisition"]:
            self._alarms.end("samples")
            self._alarms.end("acquisition")
        if self._last_heard_s["estimator"] and self.is_sampling and silent_s["estimator"] >= SILENCE_ALARM_S:
            self._alarms.raise_technical("estimates", Priority.MEDIUM, "No estimates arrive: the tissue is not watched")
        elif estimating and alive["estimator"]:
            self._alarms.end("estimates")
            self._alarms.end("estimator")
        self._check_heartbeat("recorder", now, RECORDER_HUNG_TIMEOUT_S, since_last_s, "nothing is recorded")
        self._check_heartbeat(
            "guard", now, SAFETY_MONITOR_HUNG_TIMEOUT_S, since_last_s, "a hung acquisition would be noticed late"
        )
        self._check_starts(since_last_s)
        for name, since_s in silent_s.items():
            expected = name == "acquisition" or self.is_sampling
            if alive[name] and expected and since_s >= SILENCE_ALARM_S:
                self._kill_if_hung(name, since_s, HUNG_TIMEOUT_S, since_last_s)

    def _check_starts(self, since_last_s: float) -> None:
        """Kill a worker that hangs before its first message."""
        for name in self._idle_start_s.keys() & self._supervisor.workers.keys():
            idle_s = self._idle_start_s[name] + since_last_s if self._supervisor.is_idle_start(name) else 0.0
            self._idle_start_s[name] = idle_s
            if idle_s > HUNG_START_TIMEOUT_S:
                self._idle_start_s[name] = 0.0
                self._publish_event(f"The {display_worker_name(name)} worker does not start: it is ended and replaced")
                self._supervisor.kill(name)

    def _check_heartbeat(self, name: str, now: float, hung_s: float, since_last_s: float, consequence: str) -> None:
        """Check a worker that sends signs of life even when it is idle."""
        heard_s = self._last_heard_s[name]
        if not heard_s or self._supervisor.workers[name].condition is not WorkerCondition.RUNNING:
            return
        if now - heard_s < SILENCE_ALARM_S:
            self._alarms.end(name)
            return
        text = f"The {display_worker_name(name)} does not answer: {consequence}"
        self._alarms.raise_technical(name, Priority.MEDIUM, text)
        self._kill_if_hung(name, now - heard_s, hung_s, since_last_s)

    def _kill_if_hung(self, name: str, silent_s: float, hung_s: float, since_last_s: float) -> None:
        """Kill a worker that was silent for `hung_s` while it could run, or much longer while it could not."""
        unable_s = self._kept_from_running_s.get(name, 0.0)
        if unable_s < MAX_KEPT_FROM_RUNNING_S and self._supervisor.is_kept_from_running(name):
            unable_s = self._kept_from_running_s[name] = unable_s + since_last_s
        if silent_s - unable_s > hung_s:
            self._publish_event(f"The {display_worker_name(name)} worker does not answer: it is ended and replaced")
            self._supervisor.kill(name)
