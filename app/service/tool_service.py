"""The tool service: the server's parts around one tool, and their common life."""

import asyncio
import time
from datetime import UTC, datetime

import zmq.asyncio
from pydantic import BaseModel

from acquisition.worker_process import take_server_priority
from app.host.logs import LogContext
from app.index.store import Store
from app.messages.grasps import GraspEnded
from app.messages.journal import JournalKind
from app.service.arming import ArmingController
from app.service.block_receiver import BlockReceiver
from app.service.bus_listener import BusListener
from app.service.commander import Commander
from app.service.condition_checks import ConditionChecks
from app.service.control_lease import ControlLease
from app.service.live_stream import LiveStream
from app.service.metrics import Metrics
from app.service.publisher import Publisher
from app.service.recorder_link import RecorderLink
from app.service.run_controller import RunController
from app.service.runs import RunRegistry
from app.service.sample_monitor import SampleMonitor
from app.service.server_heartbeat import send_heartbeats
from app.service.state_reporter import StateReporter
from app.service.supervisor import Supervisor
from app.service.task_watch import TaskWatch
from app.service.watchdog import Watchdog
from app.service.worker_monitor import WorkerMonitor
from app.stream.descriptions import build_hello
from config.service_plan import ServicePlan
from estimator.decision import NO_ANSWER, UNDECIDED, UNKNOWN

MAX_INITIAL_GRASPS = 200  # finished grasps of the last run that a new viewer receives


class ToolService:
    """The server's picture of one tool. Each part below reads only parts that are made before it."""

    def __init__(self, plan: ServicePlan, store: Store, log_context: LogContext) -> None:
        self.plan = plan
        self.started_at = datetime.now(UTC).isoformat(timespec="seconds")
        self._context, self._listener = zmq.asyncio.Context(), BusListener()
        self.supervisor = supervisor = Supervisor(plan)
        self.publisher = publisher = Publisher(plan, store, supervisor.endpoints.events)
        self.viewer_hub, self.index_writer = publisher.viewer_hub, publisher.index_writer
        self.journal, self.alarms = publisher.journal, publisher.alarms
        self.commander = commander = Commander(self._context, supervisor.endpoints.commands)
        self.tasks = tasks = TaskWatch(commander, self.alarms)
        self._metrics = metrics = Metrics(supervisor.workers, (*plan.library.tissues, UNKNOWN, UNDECIDED, NO_ANSWER))
        self.runs = runs = RunRegistry(plan)
        self.control_lease = lease = ControlLease(plan.settings.people.control_expires_s)
        self._checks = checks = ConditionChecks(plan, self.alarms)
        self._watchdog = watchdog = Watchdog(supervisor, self.alarms, publisher.publish_event)
        self.arming = arming = ArmingController(commander, self.alarms, supervisor, publisher.publish_event)
        self.recorder_link = recorder = RecorderLink(plan, publisher)
        self._sample_monitor = samples = SampleMonitor(plan.tool, self.alarms, metrics)
        self._live_stream = live = LiveStream(plan, publisher, runs, metrics, log_context)
        is_replay = bool(plan.opened_recordings)
        self.state = state = StateReporter(
            publisher, supervisor, watchdog, tasks, runs, arming, lease, samples, recorder, checks, metrics, is_replay
        )
        self.run_controller = RunController(
            plan, publisher, commander, supervisor, arming, runs, samples, state, log_context
        )
        self.receiver = BlockReceiver(publisher, supervisor, watchdog, arming, samples, live, state, metrics)
        self.worker_monitor = WorkerMonitor(
            publisher, supervisor, watchdog, arming, recorder, self.receiver, self.run_controller, state, metrics
        )

    async def start(self) -> None:
        """Start the workers. The tool is opened once the filters are ready, which may have to be compiled."""
        self.index_writer.start()
        self.run_controller.fail_interrupted_runs()
        if self.plan.opened_recordings:
            return
        endpoints, monitor = self.supervisor.endpoints, self.worker_monitor
        for address, on_message in (
            (endpoints.estimates, monitor.on_estimator),
            (endpoints.samples, monitor.on_acquisition),
            (endpoints.recorder, monitor.on_recorder),
            (endpoints.safety_monitor, monitor.on_safety_monitor),
            (endpoints.foxglove, monitor.on_foxglove),
        ):
            self.tasks.start(self._listener.listen(address, on_message))
        self.tasks.start(self._run_frame_loop())
        self.tasks.start(send_heartbeats(self._context, endpoints.server_heartbeat, self._metrics))
        self.supervisor.start(monitor.on_death, monitor.on_motor_fault, self.tasks.watch)
        self._realtime_priority = take_server_priority(self.plan.settings.realtime.priority)
        monitor.realtime["server"] = str(self._realtime_priority)

    async def stop(self) -> None:
        """Bring the motor to zero, then end the tasks and the workers."""
        try:
            await self.run_controller.halt()
        finally:
            await self.tasks.aclose()
            await self.supervisor.stop()
            await self.recorder_link.aclose()
            self.publisher.close()
            await self.commander.aclose()
            self._context.destroy(linger=0)
            self._listener.close()

    async def _run_frame_loop(self) -> None:
        """Send frames at a steady rate, check for silent workers, and publish the state once a second."""
        period_s = 1.0 / self.plan.settings.server.frame_rate_hz
        due, told_s = time.monotonic(), 0.0
        while True:
            due += period_s
            await asyncio.sleep(max(due - time.monotonic(), 0.0))
            asked = due
            due = max(due, time.monotonic() - period_s)
            self._live_stream.send_frames()
            self._watchdog.check(max(time.monotonic() - asked, 0.0))
            if time.monotonic() - told_s >= 1.0:
                told_s = time.monotonic()
                self._realtime_priority.renew()
                self._checks.check_disk()
                self._sample_monitor.end_old_alarms()
                self._checks.check_calibration()
                self.control_lease.renew(self.runs.current.by if self.runs.current else None)
                self.state.publish()

    def release_control(self, name: str) -> bool:
        """Release control of the tool; return False if `name` did not have it."""
        if not self.control_lease.release(name):
            return False
        self.publisher.publish_event("Control given back", JournalKind.ACCESS, name)
        self.state.publish()
        return True

    def initial_messages(self, after: int | None = None) -> tuple[list[BaseModel], list[bytes]]:
        """Return a viewer's first messages, and frames with the last seconds of samples.

        A viewer that has received all events up to `after` gets those after it instead of the last run's grasps.
        """
        missed = None if after is None else self.viewer_hub.list_events_after(after)
        hello = build_hello(self.plan, self.plan.tool, recording=bool(self.plan.opened_recordings))
        messages: list[BaseModel] = [
            hello.model_copy(update={"resumed": None if after is None else missed is not None}),
            self.state.build().model_copy(update={"event_number": None}),
        ]
        if missed is not None:
            messages += missed
        elif run := self.runs.last:
            grasps = self.runs.list_grasps(run.id)[-MAX_INITIAL_GRASPS:]
            messages += [GraspEnded(run_id=run.id, grasp=grasp) for grasp in grasps]
        messages += self.alarms.current_alarms()
        if self._live_stream.identification:
            messages.append(self._live_stream.identification)
        return messages, self._live_stream.history_frames()
