"""The tool service: follows the workers on the bus, keeps runs and alarms, serves viewers and sends commands."""

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable
from datetime import UTC, date, datetime

import zmq
import zmq.asyncio
from pydantic import BaseModel

from acquisition import bus
from acquisition.notices import (
    Acquiring,
    AcquisitionFailed,
    AcquisitionStalled,
    CompilingFilters,
    Estimating,
    GraspReleased,
    Monitoring,
    MotorNotZeroed,
    MotorZeroed,
    Notice,
    RecorderStatus,
    RunEnded,
    RunMetadata,
)
from acquisition.recordings.file_names import DEMO_ID_PREFIX
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SampleBlock
from acquisition.worker_process import take_server_priority
from app.audit.journal import Journal
from app.host.clock import monotonic_to_wall_ms, now_ms
from app.host.disk import free_bytes
from app.host.logs import LogContext
from app.index.index_writer import IndexWriter
from app.index.ingest import IndexedMessage
from app.index.rebuild import BEHIND_MARKER_FILE
from app.index.store import Store
from app.messages.alarms import AlarmKind
from app.messages.grasps import Grasp, GraspEnded, Identification
from app.messages.journal import JournalKind
from app.messages.live import EventMessage, Phase, State
from app.messages.runs import Run, RunState
from app.service.arming import CALIBRATION_ARM_REASON, ArmingController
from app.service.commander import Commander
from app.service.control_lease import ControlLease
from app.service.metrics import Metrics
from app.service.recorder_link import RecorderLink
from app.service.runs import RunRegistry, RunUnderWayError
from app.service.supervisor import Supervisor, WorkerCondition
from app.service.watchdog import Watchdog
from app.stream.alarms import AlarmManager
from app.stream.descriptions import build_hello
from app.stream.event_translator import EventTranslator
from app.stream.frames import FrameBuffer
from app.stream.sample_aligner import SampleAligner
from app.stream.viewers import ViewerHub
from config.errors import GraspwatchError, RefusedError, ServiceError
from config.load import build_graspable_library
from config.schema import GraspProtocol, ToolKind
from config.service_plan import ServicePlan
from estimator.decision import UNDECIDED, UNKNOWN
from estimator.estimate_block import finite_or_none
from estimator.estimate_messages import unpack_estimates
from estimator.force_alarms import Priority

MAX_INITIAL_GRASPS = 200  # finished grasps of the last run that a new viewer receives
MAX_MESSAGES_PER_TURN = 50  # of one bus socket, before other tasks of the event loop run
LOW_DISK_BYTES = 200e6  # a few minutes of a recording
LOSS_ALARM_DURATION_S = 5.0
HEARTBEAT_PERIOD_S = 0.05
"""A run ends when signs of life stop for `server_silence_s`, which is at least six of these periods."""
LATE_SAMPLES_S = 0.1  # samples read later than this count as late
CLOCK_DRIFT_PER_BLOCK_S = 5e-7  # 100 ppm between the clocks of board and computer, for a block of 5 ms


class ToolService:
    """The server's picture of one tool, with its workers, runs, alarms and viewers."""

    def __init__(self, plan: ServicePlan, store: Store, log_context: LogContext) -> None:
        self.plan, self.log_context = plan, log_context
        self.started_at = datetime.now(UTC).isoformat(timespec="seconds")
        self.viewer_hub = ViewerHub(plan.settings.server.chart_window_frames)
        self.index_writer = IndexWriter(store, plan.data_folder / BEHIND_MARKER_FILE, self._on_index_fault)
        self.journal = Journal(plan.data_folder, self._on_journal_fault, self._record)
        self.alarms = AlarmManager(self._publish, self.journal)
        self.supervisor = Supervisor(plan, self._on_worker_death, self._on_motor_fault, self.supervise_task)
        labels = (*plan.library.tissues, UNKNOWN, UNDECIDED)
        self.metrics = Metrics(self.supervisor.workers, labels)
        self.watchdog = Watchdog(self.supervisor, self.alarms, self.publish_event)
        self.runs = RunRegistry()
        self.control_lease = ControlLease(plan.settings.people.control_expires_s)
        self.demo_text: str | None = (
            "The demonstration begins as soon as the tool is ready" if plan.demo_enabled else None
        )
        self.internal_error: str | None = None
        self.simulated_tissue = plan.simulated_tissue if plan.tool.kind is ToolKind.SIMULATED else None
        self._context, self._subscriber_context = zmq.asyncio.Context(), zmq.Context()
        self._commander = Commander(self._context, self.supervisor.endpoints.commands)
        self.arming = ArmingController(self._commander, self.alarms, self.supervisor, self.publish_event)
        self.recorder_link = RecorderLink(
            plan, self.supervisor.endpoints.events, self.alarms, self.index_writer, self.publish_event
        )
        self._tasks: list[asyncio.Task[None]] = []
        rate_hz, tissues = plan.tool.board.sample_rate_hz, len(plan.library.tissues)
        self._frame_buffer = FrameBuffer(int(plan.settings.server.history_s * rate_hz))
        self._aligner = SampleAligner(self._frame_buffer, tissues)
        self._translator = self._make_translator()
        self._sample_sequence = bus.SequenceTracker()
        self._estimate_sequence = bus.SequenceTracker()
        self._recent_sample_counts: deque[tuple[float, int]] = deque(maxlen=400)
        self._min_delay_s = float("inf")
        self._estimate_latency_ms: float | None = None
        self.lost_samples = 0
        self._last_loss_s = self._last_late_s = 0.0
        self._free_bytes = free_bytes(plan.data_folder)
        self._last_tick = -1
        self._limit_n: float | None = None
        self._fault_texts: dict[str, str] = {}
        self.block_listeners: list[Callable[[SampleBlock], None]] = []  # called with every block
        self.realtime: dict[str, str] = {}  # scheduling that the system granted each process
        self._acquisition_died_ns = 0  # monotonic time at which the last acquisition worker died
        self._shutting_down = False
        self._stop_count = 0
        self.estimator_ready = asyncio.Event()  # once it is set, the acquisition may open the tool

    # --- life --------------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Start the workers. The tool is opened once the filters are ready, which may have to be compiled."""
        self.index_writer.start()
        self._fail_interrupted_runs()
        if self.plan.opened_recordings:
            return
        endpoints = self.supervisor.endpoints
        for work in (
            self._listen(endpoints.estimates, self._on_estimator),
            self._listen(endpoints.samples, self._on_acquisition),
            self._listen(endpoints.recorder, self._on_recorder),
            self._listen(endpoints.safety_monitor, self._on_safety_monitor),
            self._listen(endpoints.foxglove, self._on_foxglove),
            self._run_frame_loop(),
            self._send_heartbeats(endpoints.server_heartbeat),
        ):
            task = asyncio.create_task(work)
            self.supervise_task(task)
            self._tasks.append(task)
        self.supervisor.start_recorder()
        self.supervisor.start_safety_monitor()
        self.supervisor.start_estimator()
        self.supervisor.start_acquisition()
        self.supervisor.start_foxglove()
        self._realtime_priority = take_server_priority(self.plan.settings.realtime.priority)
        self.realtime["server"] = str(self._realtime_priority)

    def _fail_interrupted_runs(self) -> None:
        """Mark runs that a killed service left open as failed.

        If another service uses the same index, the runs may belong to it and stay open.
        """
        for run in self.index_writer.store.find_unfinished_runs() if self.index_writer.store.is_first_user else []:
            why = "the service was ended from outside during the run"
            run = run.model_copy(update={"state": RunState.FAILED, "why": why})
            self.journal.write(JournalKind.RUN, f"Run {run.id} failed: {why}", run=run)

    def supervise_task(self, task: asyncio.Task[None]) -> None:
        """Watch a task that must not end unnoticed."""
        task.add_done_callback(self._on_task_end)

    def _on_task_end(self, task: asyncio.Task[None]) -> None:
        """If a task failed, bring the motor to zero, raise an alarm and report the service as faulted."""
        if task.cancelled() or not task.exception():
            return
        self.internal_error = f"The server failed inside ({task.exception()!r}). Start the service again."
        logging.getLogger("graspwatch").error("the server failed inside", exc_info=task.exception())
        self.alarms.raise_technical("server", Priority.HIGH, self.internal_error)
        self._stop_task = asyncio.create_task(self._commander.send(bus.StopCommand("the server failed")))

    async def halt(self) -> None:
        """Stop the run under way, and refuse every start from now on."""
        self._shutting_down = True
        if self.runs.current:
            with contextlib.suppress(ServiceError):  # `stop` ends a worker that does not answer
                await self.stop_run("the service was ended")

    async def stop(self) -> None:
        """Bring the motor to zero, then end the tasks and the workers."""
        try:
            await self.halt()
        finally:
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            await self.supervisor.stop()
            await self.recorder_link.aclose()
            await self._commander.aclose()
            self._context.destroy(linger=0)
            self._subscriber_context.destroy(linger=0)

    # --- commands ----------------------------------------------------------------------------------------------------

    async def start_run(
        self,
        protocol: GraspProtocol,
        cycles: int,
        tissue: str | None,
        by: str | None,
        unmeasured_scale_reason: str = "",
    ) -> Run:
        """Start a run. A tool that is not armed is armed first, unless the settings forbid it.

        `unmeasured_scale_reason`: why the tool may be armed although its force scale is not measured.

        Raises:
            RefusedError: a fault is latched, the tool cannot be armed, another run is under way, the service is ending,
                or the acquisition refuses.
            ServiceError: the acquisition does not answer.
        """
        self.arming.check_no_fault()
        stops = self._stop_count
        if self.arming.safety is not Safety.ARMED and self.plan.settings.safety.arm_with_start:
            await self.arming.arm(by, unmeasured_scale_reason)
        if (
            self.arming.unmeasured_scale_reason == CALIBRATION_ARM_REASON
            and unmeasured_scale_reason != CALIBRATION_ARM_REASON
        ):
            raise RefusedError("The tool is armed for a calibration alone. Disarm it first.")
        self._check_can_start()
        prefix = DEMO_ID_PREFIX if self.demo_text else ""
        run = self.runs.begin(protocol.name, cycles, tissue, by, self._last_tick, prefix)  # refuses every other start
        self.log_context.run = run.id
        self.recorder_link.announce_run(RunMetadata(run.id, protocol.model_dump_json(), cycles, tissue, by))
        try:
            await self._commander.send(bus.StartCommand(run.id, protocol.model_dump_json(), cycles, tissue))
        except GraspwatchError as error:
            self.runs.discard(run.id)
            self.log_context.run = None
            if isinstance(error, ServiceError):  # the acquisition may still obey
                with contextlib.suppress(ServiceError):
                    await self._commander.send(bus.StopCommand("nobody waits for this run any more"))
            raise
        self._record(run)
        self.simulated_tissue = tissue or self.simulated_tissue
        held = f", {build_graspable_library(self.plan.library).tissues[tissue].title.lower()}" if tissue else ""
        self.publish_event(f"Run started: {protocol.title}, {cycles} grasps{held}", JournalKind.RUN, by, run)
        if self._stop_count != stops:  # the acquisition may have received the stop before the start
            await self.stop_run("it was stopped while it began")
        self.publish_state()
        return self.runs.get(run.id) or run

    async def set_simulated_pull_and_gauge(self, load: bus.SimulatedPullAndGaugeCommand) -> None:
        """Set the pull on a simulated tool's handle and the gauge between its jaws.

        Raises:
            ServiceError: the acquisition does not answer.
        """
        await self._commander.send(load)

    def _check_can_start(self) -> None:
        """Check that the service is not ending and no run is under way.

        Raises:
            RefusedError: either is the case; the text says which.
        """
        if self._shutting_down:
            raise RefusedError("The service is being ended: start nothing any more.")
        if self.runs.current:
            raise RunUnderWayError(self.runs.current)

    async def stop_run(self, why: str, find_requester: Callable[[], Awaitable[str | None]] | None = None) -> bool:
        """Bring the motor to zero at once, and return whether a run was stopped. A stop is never refused.

        `find_requester` returns the requester's name; it is awaited after the stop, which it cannot delay.

        Raises:
            ServiceError: the acquisition does not answer; if it has died, the supervisor zeroes the motor.
        """
        if not self.estimator_ready.is_set():
            return False  # no motor exists, or no worker can move it yet
        self._stop_count += 1
        effect = await self._commander.send(bus.StopCommand(why))
        current = self.runs.current
        if effect and current:
            self._end_run(current.id, RunState.STOPPED, why)
        self.publish_event(
            f"Stopped: the motor is at zero ({why})",
            JournalKind.RUN,
            await find_requester() if find_requester else None,
        )
        return effect

    # --- messages of the workers -------------------------------------------------------------------------------------

    async def _listen(self, address: str, on_message: Callable[[list[bytes]], None]) -> None:
        """Pass each message published at `address` to `on_message`.

        The event loop watches the socket itself: a future for each message cost as much time as handling it.
        """
        loop, readable = asyncio.get_running_loop(), asyncio.Event()
        socket = bus.open_subscriber(self._subscriber_context, address)
        loop.add_reader(socket.FD, readable.set)
        readable.set()  # messages that came before the line above do not wake the loop
        try:
            while True:
                await readable.wait()
                readable.clear()
                for _ in range(MAX_MESSAGES_PER_TURN):
                    if not socket.getsockopt(zmq.EVENTS) & zmq.POLLIN:
                        break
                    on_message(socket.recv_multipart(zmq.NOBLOCK))
                else:
                    readable.set()
                    await asyncio.sleep(0)
        finally:
            loop.remove_reader(socket.FD)
            socket.close()

    def _on_acquisition(self, parts: list[bytes]) -> None:
        if parts[0] == bus.NOTICE_TOPIC:
            self._on_notice(bus.unpack_notice(parts))
            return
        block = bus.unpack_samples(parts)
        is_alive = block.t_mono_ns > self._acquisition_died_ns
        if is_alive and self.supervisor.mark_running("acquisition"):
            self.alarms.end("motor")  # a worker that opens the board first writes zero
            self.publish_state()
        if self._sample_sequence.is_out_of_order(block):
            return
        if self._sample_sequence.is_restart(block.sequence):
            self._aligner.reset()
            self._reset_grasp()
            self.runs.reset_ticks()
        if is_alive and self.arming.update_from_block(block):
            self.publish_state()
        missing = self._sample_sequence.update(block.sequence, block.t_mono_ns)
        self._last_tick = int(block.samples["tick"][-1])
        self._limit_n = finite_or_none(float(block.samples["limit_n"][-1]))
        self.watchdog.feed("acquisition")
        self._recent_sample_counts.append((time.monotonic(), len(block.samples)))
        self._observe_lateness(block)
        self._check_lateness(block)
        self.metrics.samples.inc(len(block.samples))
        self._count_lost_samples(block.lost_samples + missing * len(block.samples))
        for follow in self.block_listeners:
            follow(block)
        self.metrics.missing_blocks.labels("server").set(
            self._sample_sequence.missing + self._estimate_sequence.missing
        )
        self._aligner.add_samples(block)

    def _observe_lateness(self, block: SampleBlock) -> None:
        """Measure how much later a block was read than the promptest so far, relative to the sample clock."""
        clock_s = (int(block.samples["tick"][-1]) + 1) / self.plan.tool.board.sample_rate_hz
        behind_s = block.t_mono_ns / 1e9 - clock_s
        if block.sequence == 1:
            self._min_delay_s = behind_s
        self._min_delay_s = min(self._min_delay_s + CLOCK_DRIFT_PER_BLOCK_S, behind_s)
        self.metrics.acquisition_lateness.observe(behind_s - self._min_delay_s)

    def _check_lateness(self, block: SampleBlock) -> None:
        """Count a block that was read late; in a run, where the limiter then acts late too, raise an alarm."""
        if block.backlog <= LATE_SAMPLES_S * self.plan.tool.board.sample_rate_hz:
            return
        self.metrics.late_blocks.inc()
        if not block.run:
            return
        self._last_late_s = time.monotonic()
        text = f"Samples are read more than {LATE_SAMPLES_S:g} s late, and the limiter acts as late: end other programs"
        self.alarms.raise_technical("late", Priority.MEDIUM, text)

    def _make_translator(self) -> EventTranslator:
        rate_hz = self.plan.tool.board.sample_rate_hz
        return EventTranslator(self.plan.library, rate_hz, self.alarms, self._publish, self._on_grasp_ended)

    def _publish(self, message: BaseModel) -> None:
        """Send a message to the viewers, the recorder and the index."""
        if isinstance(message, Identification):
            self.log_context.grasp = message.grasp if message.in_grasp else None
        self.viewer_hub.broadcast(message)
        self._record(message)

    def _record(self, message: BaseModel) -> None:
        self.recorder_link.send_message(message)
        if isinstance(message, IndexedMessage):
            self.index_writer.enqueue(message)

    def _reset_grasp(self) -> None:
        """Forget the grasp under way after a worker died or restarted: no message about its end will come."""
        self.log_context.grasp = None
        self.alarms.end_force_alarm()
        self._translator = self._make_translator()

    def _on_journal_fault(self, fault: str | None) -> None:
        if fault:
            self.alarms.raise_technical("journal", Priority.LOW, fault)
        else:
            self.alarms.end("journal")

    def _on_index_fault(self, fault: str | None) -> None:
        if fault:
            self.alarms.raise_technical("index", Priority.LOW, fault)
        else:
            self.alarms.end("index")

    def _check_disk(self) -> None:
        """Update the alarms about disk space, and end those about samples lost or late some seconds ago."""
        self._free_bytes = free_bytes(self.plan.data_folder)
        if self._free_bytes is None:
            self.alarms.raise_technical(
                "disk", Priority.MEDIUM, f"The data folder {self.plan.data_folder} is gone: mend it"
            )
        elif self._free_bytes < LOW_DISK_BYTES:
            full = f"The disk of {self.plan.data_folder} is full: make room, or empty the bin of the recordings"
            self.alarms.raise_technical("disk", Priority.MEDIUM, full)
        else:
            self.alarms.end("disk")
        if time.monotonic() - self._last_loss_s > LOSS_ALARM_DURATION_S:
            self.alarms.end("lost")
        if time.monotonic() - self._last_late_s > LOSS_ALARM_DURATION_S:
            self.alarms.end("late")

    def _check_calibration(self) -> None:
        if self.plan.opened_recordings:
            return
        tool = self.plan.tool
        if expired := tool.find_expired_constants(date.today()):
            names = ", ".join(f"{each.constant} ({each.expires})" for each in expired)
            text = f"The tool's calibration is expired: {names}. Measure anew before you trust forces"
            self.alarms.raise_technical("calibration", Priority.LOW, text)
        if not tool.has_known_scale:
            text = f"The tool's force scale is not measured ({tool.scale_text}): newtons may be wrong by that much"
            self.alarms.raise_technical("scale", Priority.LOW, text)

    def _count_lost_samples(self, samples: int) -> None:
        if samples:
            self.lost_samples += samples
            self._last_loss_s = time.monotonic()
            self.metrics.lost_samples.inc(samples)
            self.alarms.raise_technical("lost", Priority.LOW, "Samples are being lost: the status strip counts them")

    def _on_estimator(self, parts: list[bytes]) -> None:
        if parts[0] == bus.NOTICE_TOPIC:
            self._on_notice(bus.unpack_notice(parts))
            return
        received = unpack_estimates(parts, len(self.plan.library.tissues))
        block = received.block
        self.watchdog.feed("estimator")
        self._estimate_sequence.update(block.sequence)
        self._estimate_latency_ms = (received.published_ns - block.t_mono_ns) / 1e6
        self.metrics.estimate_latency.observe(self._estimate_latency_ms / 1e3)
        self.metrics.missing_blocks.labels("estimator").set(received.missing_blocks)
        self._aligner.add_estimates(block)
        self._translator.process(block, now_ms(), monotonic_to_wall_ms(block.t_mono_ns))

    def _on_notice(self, notice: Notice) -> None:
        match notice:
            case CompilingFilters():
                self.publish_event("Preparing the filters (compiled on the first start, which takes up to a minute)")
            case Estimating():
                self._fault_texts.pop("estimator", None)
                self.realtime["estimator"] = notice.realtime
                if self.supervisor.mark_running("estimator"):
                    self.watchdog.on_estimator_started()
                self.estimator_ready.set()
                self.supervisor.open_tool()
            case Acquiring():
                self._fault_texts.pop("acquisition", None)
                self.realtime["acquisition"] = notice.realtime
                self.publish_event(f"The tool is acquiring; {notice.realtime}")
            case AcquisitionFailed():
                self._fault_texts["acquisition"] = notice.text
                self.alarms.raise_technical("acquisition", Priority.HIGH, notice.text)
            case AcquisitionStalled():
                self.publish_event(notice.text)
            case GraspReleased():
                self.alarms.raise_latched("let-go", AlarmKind.FORCE, notice.text)
            case RunEnded():
                self._end_run(notice.run_id, RunState(notice.end), notice.why)
        self.publish_state()

    def _on_recorder(self, parts: list[bytes]) -> None:
        self.watchdog.feed("recorder")
        self.supervisor.mark_running("recorder")
        before = self.recorder_link.state.file
        notice = bus.unpack_notice(parts)
        if isinstance(notice, RecorderStatus):
            self.realtime["recorder"] = notice.realtime
        self.recorder_link.on_notice(notice)
        if self.recorder_link.state.file != before:
            self.publish_state()

    def _on_safety_monitor(self, parts: list[bytes]) -> None:
        self.watchdog.feed("guard")
        self.supervisor.mark_running("guard")
        notice = bus.unpack_notice(parts)
        match notice:
            case Monitoring():
                self.realtime["guard"] = notice.realtime
            case MotorZeroed():
                self._on_motor_fault(None)
                self.alarms.raise_technical("samples", Priority.HIGH, notice.text)
            case MotorNotZeroed():
                self._on_motor_fault(notice.text)

    def _on_foxglove(self, parts: list[bytes]) -> None:
        if self.supervisor.mark_running("foxglove"):
            self.alarms.end("foxglove")
            self.publish_state()

    def _on_motor_fault(self, fault: str | None) -> None:
        """Raise an alarm if the motor of a dead or silent worker cannot be brought to zero; None ends the alarm."""
        if fault:
            self.alarms.raise_technical("motor", Priority.HIGH, fault)
        else:
            self.alarms.end("motor")

    def _on_grasp_ended(self, grasp: Grasp) -> None:
        self.metrics.grasps.labels(grasp.label).inc()
        run_id, grasp = self.runs.add_grasp(grasp, round(grasp.start_s * self.plan.tool.board.sample_rate_hz))
        self._publish(GraspEnded(run_id=run_id, grasp=grasp))

    def _end_run(self, run_id: str, state: RunState, why: str) -> None:
        if not self.runs.end(run_id, state, why):
            return
        ended = self.runs.get(run_id)
        if ended:
            self._record(ended)
        self.publish_event(f"Run {state.value}: {why}", JournalKind.RUN, run=ended)
        self.log_context.run = None
        if state is not RunState.FINISHED:
            self.demo_text = None
        self.publish_state()

    def _on_worker_death(self, worker: str, text: str) -> None:
        self.metrics.worker_deaths.labels(worker).inc()
        if worker == "recorder":
            self.recorder_link.on_worker_death(text)
            self.publish_state()
            return
        if worker == "foxglove":
            self.alarms.raise_technical(worker, Priority.LOW, text)
            return
        if worker == "guard":
            self.alarms.raise_technical(worker, Priority.HIGH, f"{text} A hung acquisition would be noticed late")
            return
        self._reset_grasp()
        text = " ".join(filter(None, (self._fault_texts.pop(worker, None), text)))
        self.alarms.raise_technical(worker, Priority.HIGH, text)
        self.publish_event(text)
        current = self.runs.current
        if worker == "acquisition":
            self._acquisition_died_ns = time.monotonic_ns()
            self.arming.on_worker_death("the acquisition worker died")
            if current:
                self._end_run(current.id, RunState.FAILED, "the acquisition worker died")
        self.publish_state()

    async def _send_heartbeats(self, address: str) -> None:
        """Send signs of life to the acquisition from the event loop that carries STOP, never from another thread."""
        signs = bus.open_publisher(self._context, address)
        try:
            while True:
                asked_s = time.monotonic()
                await signs.send(b"")
                await asyncio.sleep(HEARTBEAT_PERIOD_S)
                self.metrics.server_delay.observe(max(time.monotonic() - asked_s - HEARTBEAT_PERIOD_S, 0.0))
        finally:
            signs.close()

    # --- messages to the viewers -------------------------------------------------------------------------------------

    async def _run_frame_loop(self) -> None:
        """Send frames at a steady rate, check for silent workers, and publish the state once a second."""
        period_s = 1.0 / self.plan.settings.server.frame_rate_hz
        due, told_s = time.monotonic(), 0.0
        while True:
            due += period_s
            await asyncio.sleep(max(due - time.monotonic(), 0.0))
            asked = due
            due = max(due, time.monotonic() - period_s)
            self._aligner.align()
            for frame in self._frame_buffer.cut_frames():
                self.viewer_hub.broadcast_frame(frame)
            self.watchdog.check(max(time.monotonic() - asked, 0.0))
            if time.monotonic() - told_s >= 1.0:
                told_s = time.monotonic()
                self._realtime_priority.renew()
                self._check_disk()
                self._check_calibration()
                self.control_lease.renew(self.runs.current.by if self.runs.current else None)
                self.publish_state()

    def render_metrics(self) -> bytes:
        """Return the metrics in the text format of Prometheus."""
        self.metrics.phase.state(self.phase.value)
        self.metrics.set_alarm_counts(self.alarms.current_alarms())
        self.metrics.free_disk.set(float("nan") if self._free_bytes is None else self._free_bytes)
        self.metrics.recording.set(self.recorder_link.state.file is not None)
        self.metrics.viewers.set(len(self.viewer_hub.viewers))
        self.metrics.index_dropped_messages.set(self.index_writer.dropped_messages)
        return self.metrics.render()

    def worker_conditions(self) -> dict[str, str]:
        """Return each worker's condition; empty for a service that only shows recordings."""
        if self.plan.opened_recordings:
            return {}
        return {name: worker.condition.value for name, worker in self.supervisor.workers.items()}

    @property
    def phase(self) -> Phase:
        if self.plan.opened_recordings:
            return Phase.REPLAY
        needed = {"acquisition", "estimator"} if self.runs.current else {"acquisition", "estimator", "guard"}
        conditions = {each.condition for name, each in self.supervisor.workers.items() if name in needed}
        if self.internal_error or WorkerCondition.FAULTED in conditions:
            return Phase.FAULTED
        if conditions != {WorkerCondition.RUNNING} or not self.watchdog.is_sampling:
            return Phase.STARTING
        return Phase.RUNNING if self.runs.current else Phase.IDLE

    def _measure_rate_hz(self) -> float:
        if len(self._recent_sample_counts) < 2 or time.monotonic() - self._recent_sample_counts[-1][0] > 1.0:
            return 0.0
        return sum(n for _, n in list(self._recent_sample_counts)[1:]) / (
            self._recent_sample_counts[-1][0] - self._recent_sample_counts[0][0]
        )

    def build_state(self) -> State:
        return State(
            server_time_ms=now_ms(),
            phase=self.phase,
            safety=self.arming.safety,
            safety_why=self.arming.why or None,
            run=self.runs.current,
            last_run=self.runs.last,
            limit_n=self._limit_n,
            simulated_tissue=self.simulated_tissue,
            demo=self.demo_text,
            control=self._control_holder(),
            rate_hz=self._measure_rate_hz(),
            lost_samples=self.lost_samples,
            estimator_latency_ms=self._estimate_latency_ms,
            viewers=len(self.viewer_hub.viewers),
            recording=self.recorder_link.state,
            free_disk_bytes=self._free_bytes,
            faults=self.alarms.technical_alarm_texts(),
            event_number=self.viewer_hub.newest_event_number,
        )

    def publish_state(self) -> None:
        self.viewer_hub.broadcast(self.build_state())

    def release_control(self, name: str) -> bool:
        """Release control of the tool; return False if `name` did not have it."""
        if not self.control_lease.release(name):
            return False
        self.publish_event("Control given back", JournalKind.ACCESS, name)
        self.publish_state()
        return True

    def _control_holder(self) -> str | None:
        if self.control_lease.holder:
            return self.control_lease.holder
        run = self.runs.current
        if run is None:
            return None
        return "the demonstration" if self.demo_text else run.by or "somebody without a name"

    def publish_event(
        self, text: str, kind: JournalKind = JournalKind.EVENT, by: str | None = None, run: Run | None = None
    ) -> None:
        """Write an event to the journal and send it to the viewers."""
        self.journal.write(kind, text, by=by, run=run)
        self.viewer_hub.broadcast(EventMessage(server_time_ms=now_ms(), text=f"{text}, by {by}" if by else text))

    def initial_messages(self, after: int | None = None) -> tuple[list[BaseModel], list[bytes]]:
        """Return a viewer's first messages, and frames with the last seconds of samples.

        A viewer that has received all events up to `after` gets those after it instead of the last run's grasps.
        """
        missed = None if after is None else self.viewer_hub.list_events_after(after)
        hello = build_hello(self.plan, self.plan.tool, recording=bool(self.plan.opened_recordings))
        messages: list[BaseModel] = [
            hello.model_copy(update={"resumed": None if after is None else missed is not None}),
            self.build_state().model_copy(update={"event_number": None}),
        ]
        if missed is not None:
            messages += missed
        elif run := self.runs.last:
            grasps = self.runs.list_grasps(run.id)[-MAX_INITIAL_GRASPS:]
            messages += [GraspEnded(run_id=run.id, grasp=grasp) for grasp in grasps]
        messages += self.alarms.current_alarms()
        if self._translator.identification:
            messages.append(self._translator.identification)
        return messages, self._frame_buffer.history_frames()
