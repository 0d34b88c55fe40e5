"""The class ToolService: the server's parts around one tool, and their common start and stop."""

import asyncio
import time
from datetime import UTC, datetime
from pathlib import Path

import zmq.asyncio
from pydantic import BaseModel

from acquisition.safety_state_machine import Safety
from acquisition.worker_process import take_server_priority
from app.host.clock import now_ms
from app.host.logs import LogContext
from app.index.store import Store
from app.messages.alarms import AlarmKind
from app.messages.grasps import GraspEnded
from app.messages.journal import JournalKind
from app.messages.live import Phase
from app.service.annotations import Annotations
from app.service.arming import ArmingController
from app.service.block_receiver import BlockReceiver
from app.service.bus_listener import BusListener
from app.service.commander import Commander
from app.service.condition_checks import ConditionChecks
from app.service.control_lease import ControlLease
from app.service.lab_sessions import LabSessions
from app.service.live_stream import LiveStream
from app.service.metrics import Metrics
from app.service.publisher import Publisher
from app.service.recorder_link import RecorderLink
from app.service.reference_grasps import ReferenceGrasps
from app.service.run_controller import RunController, fail_interrupted_runs
from app.service.runs import RunRegistry, RunUnderWayError
from app.service.sample_monitor import SampleMonitor
from app.service.server_heartbeat import send_heartbeats
from app.service.state_reporter import StateReporter
from app.service.supervisor import TOOL_WORKERS, Supervisor
from app.service.task_watch import TaskWatch
from app.service.watchdog import Watchdog
from app.service.worker_monitor import WorkerMonitor
from app.service.workers import WorkerCondition
from app.stream.descriptions import build_hello
from config.errors import RefusedError
from config.load import load_tool
from config.schema import Tool
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
        self._previous_tool: tuple[Tool, str] | None = None  # and its source, until the workers run with another one
        self._watchdog = watchdog = Watchdog(supervisor, self.alarms, publisher.publish_event)
        self.arming = arming = ArmingController(plan.tool, commander, self.alarms, supervisor, publisher.publish_event)
        self.recorder_link = recorder = RecorderLink(plan, publisher)
        self.references = references = ReferenceGrasps(plan, publisher)
        self._sample_monitor = samples = SampleMonitor(plan.tool, self.alarms, metrics)
        rate_hz = plan.tool.board.sample_rate_hz
        self.annotations = annotations = Annotations(publisher, runs, samples, rate_hz)
        self.lab_sessions = sessions = LabSessions(plan.settings.laboratory, publisher, store)
        self._live_stream = live = LiveStream(plan, publisher, runs, annotations, metrics, log_context)
        is_replay = bool(plan.opened_recordings)
        self._hello = build_hello(plan, plan.tool, recording=is_replay)  # built once, because it takes 10 ms
        self.state = state = StateReporter(
            publisher,
            supervisor,
            watchdog,
            tasks,
            runs,
            arming,
            lease,
            samples,
            recorder,
            checks,
            references,
            annotations,
            sessions,
            metrics,
            is_replay,
        )
        self.run_controller = RunController(
            plan,
            publisher,
            commander,
            supervisor,
            arming,
            runs,
            samples,
            references,
            annotations,
            sessions,
            state,
            log_context,
        )
        self.receiver = BlockReceiver(publisher, supervisor, watchdog, arming, samples, live, state, metrics)
        self.receiver.listeners.append(references.on_block)
        self.worker_monitor = WorkerMonitor(
            publisher, supervisor, watchdog, arming, recorder, self.receiver, self.run_controller, state, metrics
        )

    async def start(self) -> None:
        """Start the workers. The tool is opened once the filters are ready, which may have to be compiled."""
        self.index_writer.start()
        fail_interrupted_runs(self.publisher)
        if self.plan.opened_recordings:
            return
        await self._checks.check_newer_calibration()
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
        self.supervisor.start(self._on_death, monitor.on_replacement, monitor.on_motor_fault, self.tasks.watch)
        self._realtime_priority = take_server_priority(self.plan.settings.realtime.priority)
        monitor.realtime["server"] = str(self._realtime_priority)

    async def stop(self) -> None:
        """Bring the motor to zero, then end the tasks and the workers."""
        try:
            await self.run_controller.halt()
        finally:
            await self.tasks.aclose()
            await self.references.aclose()
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
            if self._previous_tool and self.state.phase is Phase.IDLE:
                self._previous_tool = None
            self._watchdog.check(max(time.monotonic() - asked, 0.0))
            if time.monotonic() - told_s >= 1.0:
                told_s = time.monotonic()
                self._realtime_priority.renew()
                self._checks.check_disk()
                self._sample_monitor.end_old_alarms()
                self._checks.check_calibration()
                self.control_lease.renew(self.runs.current.by if self.runs.current else None)
                self.state.publish()

    async def use_tool_file(self, path: Path, by: str | None) -> None:
        """Go on with the constants of another file of the same tool, at a moment when no run is under way.

        New workers begin with them, disarmed, so that the next recordings state them. Whoever watches is told. If one
        of them dies before all run, the service returns to the tool before.

        Raises:
            RefusedError: the file differs in more than constants, a run or its recording is under way, or the tool is
                not ready.
            ConfigurationError: the file has faults, or the library was learned with other constants.
            ServiceError: the acquisition does not answer.
        """
        tool = load_tool(str(path))
        if other := self.plan.tool.find_differences_beside_constants(tool):
            raise RefusedError(
                f"{path.name} differs from the tool in use in {', '.join(other)}. Only a start of the service takes "
                "these: `graspwatch serve --tool`."
            )
        self.plan.library.check_tool(tool)
        self._check_idle()
        if self.arming.safety is not Safety.DISARMED:
            await self.arming.disarm(by)
            self._check_idle()
        self._previous_tool = self.plan.tool, self.plan.tool_source
        self._replace_tool(tool, str(path))
        await self._checks.check_newer_calibration()
        self.publisher.publish_event(f"The tool file {path.name} is used from now on; the tool is disarmed", by=by)

    def _replace_tool(self, tool: Tool, source: str) -> None:
        self.plan.tool, self.plan.tool_source = tool, source
        for name in TOOL_WORKERS:
            self._watchdog.forget(name)
        self.supervisor.use_tool(tool)
        self._checks.check_calibration()
        self._hello = build_hello(self.plan, tool)
        for message in (self._hello, self.state.build(), *self.alarms.current_alarms()):
            self.viewer_hub.broadcast(message)

    def _on_death(self, worker: str, text: str) -> None:
        """Receive the death of a worker; return to the previous tool if it began with another one and never ran."""
        self.worker_monitor.on_death(worker, text)
        is_down = self.supervisor.workers[worker].condition is WorkerCondition.FAULTED
        if worker not in TOOL_WORKERS or self._previous_tool is None or is_down:
            return
        refused = Path(self.plan.tool_source).name
        (tool, source), self._previous_tool = self._previous_tool, None
        self._replace_tool(tool, source)
        said = (
            f"The tool file {refused} could not be used: {text} The service returns to {Path(source).name}. Check the "
            "new file"
        )
        self.alarms.raise_latched("tool-file", AlarmKind.TECHNICAL, said)

    def _check_idle(self) -> None:
        """Check that the tool is at rest and its last recording is complete.

        Raises:
            RefusedError: it is not so; the text says what to do.
        """
        self.arming.check_no_fault()
        self.check_ready()
        if self.recorder_link.state.file:
            raise RefusedError("The last recording is not complete yet. Try again in a few seconds.")

    def check_ready(self) -> None:
        """Check that samples and estimates arrive, and nothing is played.

        Raises:
            RefusedError: it is not so; the text says what to do.
        """
        if self.runs.current:
            raise RunUnderWayError(self.runs.current)
        if self.runs.demo_text:
            raise RefusedError("A demonstration is under way. Stop it first.")
        if self.state.phase is not Phase.IDLE:
            raise RefusedError(f"The tool is not ready ({self.state.phase.value}). Wait, or see the alarms.")

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
        now = {"server_time_ms": now_ms(), "resumed": None if after is None else missed is not None}
        messages: list[BaseModel] = [
            self._hello.model_copy(update=now),
            self.state.build().model_copy(update={"event_number": None}),
        ]
        if missed is not None:
            messages += missed
        elif run := self.runs.last:
            grasps = self.runs.list_grasps(run.id)[-MAX_INITIAL_GRASPS:]
            messages += [GraspEnded(run_id=run.id, grasp=grasp) for grasp in grasps]
            messages += self.annotations.of_run(run.id)
        messages += self.alarms.current_alarms()
        if self._live_stream.identification:
            messages.append(self._live_stream.identification)
        return messages, self._live_stream.history_frames()
