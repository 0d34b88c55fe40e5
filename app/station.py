"""The server's picture of the tool: follows the bus, keeps runs and alarms, tells the viewers, passes commands on."""

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable
from datetime import UTC, date, datetime
from typing import Any

import zmq
import zmq.asyncio
from pydantic import BaseModel

from acquisition import bus
from acquisition.blocks import SampleBlock
from acquisition.process import serving_priority
from acquisition.safety import Safety
from app.alarms import AlarmBook
from app.arming import CALIBRATING, Arming
from app.clock import now_ms, wall_ms
from app.commander import Commander
from app.describe import hello
from app.disk import free_bytes
from app.frames import FrameBuffer
from app.joiner import Joiner
from app.journal import Journal
from app.live import Hub
from app.logs import About
from app.metrics import Metrics
from app.people.lease import Control
from app.plan import ServicePlan
from app.record.link import RecorderLink
from app.record.recorder import DEMONSTRATION, Brief
from app.runs import RunBook
from app.store.keeper import Index
from app.store.rebuild import BEHIND_MARKER
from app.store.store import Store
from app.store.taking import Indexed
from app.supervisor import Condition, Supervisor
from app.teller import Teller
from app.watchdog import Watchdog
from app.wire import (
    AlarmKind,
    EventMessage,
    Grasp,
    GraspEnded,
    Identification,
    JournalKind,
    Phase,
    Priority,
    Run,
    RunState,
    State,
)
from config.errors import GraspwatchError, RefusedError, ServiceError
from config.load import holdable
from config.schema import Protocol, ToolKind
from estimator.blocks import finite
from estimator.worker import unpack_estimates

GRASPS_TOLD = 200  # of the last run, to a viewer who comes
MOST_AT_A_TIME = 50  # messages of the workers, before anything else gets its turn
LITTLE_DISK_BYTES = 200e6  # a few minutes of a recording
LOSS_SHOWN_S = 5.0
SIGN_OF_LIFE_S = 0.05
"""From one to the next; a run ends when they stop for `server_silence_s`, which is at least six of them."""
LATE_S = 0.1  # samples read later than this are told
CLOCK_DRIFT_S = 5e-7  # a block: 100 ppm between the board's clock and the computer's


class Station:
    """One tool, its runs, its viewers."""

    def __init__(self, plan: ServicePlan, store: Store, about: About) -> None:
        self.plan, self.about = plan, about
        self.started_at = datetime.now(UTC).isoformat(timespec="seconds")
        self.metrics = Metrics()
        self.hub = Hub(plan.settings.server.chart_window_frames)
        self.index = Index(store, plan.data / BEHIND_MARKER, self._on_index)
        self.journal = Journal(plan.data, self._on_journal, self._keep)
        self.alarms = AlarmBook(self._tell, self.journal)
        self.supervisor = Supervisor(plan, self._on_death, self._on_motor, self.watch_over)
        self.watchdog = Watchdog(self.supervisor, self.alarms, self.tell_event)
        self.runs = RunBook()
        self.control = Control(plan.settings.people.control_expires_s)
        self.demo: str | None = "The demonstration begins as soon as the tool is ready" if plan.demo else None
        self.internal_error: str | None = None
        self.simulated_tissue = plan.tissue if plan.tool.kind is ToolKind.SIMULATED else None
        self._context, self._sources = zmq.asyncio.Context(), zmq.Context()
        self._commander = Commander(self._context, self.supervisor.endpoints.commands)
        self.arming = Arming(self._commander, self.alarms, self.supervisor, self.tell_event)
        self.recorder = RecorderLink(plan, self.supervisor.endpoints.events, self.alarms, self.index, self.tell_event)
        self._tasks: list[asyncio.Task[None]] = []
        rate_hz, tissues = plan.tool.board.sample_rate_hz, len(plan.library.tissues)
        self._frames = FrameBuffer(int(plan.settings.server.history_s * rate_hz))
        self._joiner = Joiner(self._frames, tissues)
        self._teller = self._new_teller()
        self._samples = bus.SequenceCounter()
        self._estimates = bus.SequenceCounter()
        self._rate: deque[tuple[float, int]] = deque(maxlen=400)
        self._promptest_s = float("inf")
        self._latency_ms: float | None = None
        self.lost_samples = 0
        self._lost_s = self._late_s = 0.0
        self._free_bytes = free_bytes(plan.data)
        self._last_tick = -1
        self._limit_n: float | None = None
        self._fault_texts: dict[str, str] = {}
        self.followers: list[Callable[[SampleBlock], None]] = []  # get every block
        self.realtime: dict[str, str] = {}  # what the system granted each worker
        self._died_ns = 0  # the last acquisition worker
        self._ending = False
        self._stops = 0
        self.estimator_ready = asyncio.Event()  # from then on the tool is opened

    # --- life --------------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Start the workers; the tool is opened when the filters, which may have to be compiled, are ready."""
        self.index.start()
        self._end_runs_cut_short()
        if self.plan.opened:
            return
        endpoints = self.supervisor.endpoints
        for work in (
            self._listen(endpoints.estimates, self._on_estimator),
            self._listen(endpoints.samples, self._on_acquisition),
            self._listen(endpoints.recorder, self._on_recorder),
            self._listen(endpoints.guard, self._on_guard),
            self._listen(endpoints.foxglove, self._on_foxglove),
            self._tick(),
            self._show_life(endpoints.server),
        ):
            task = asyncio.create_task(work)
            self.watch_over(task)
            self._tasks.append(task)
        self.supervisor.start_recorder()
        self.supervisor.start_guard()
        self.supervisor.start_estimator()
        self.supervisor.start_acquisition()
        self.supervisor.start_foxglove()
        self._priority = serving_priority(self.plan.settings.realtime.priority)
        self.realtime["server"] = str(self._priority)

    def _end_runs_cut_short(self) -> None:
        """Those of a service that was killed; unless another one lives, whose they may be."""
        for run in self.index.store.cut_short() if self.index.store.first else []:
            why = "the service was ended from outside during the run"
            run = run.model_copy(update={"state": RunState.FAILED, "why": why})
            self.journal.write(JournalKind.RUN, f"Run {run.id} failed: {why}", run=run)

    def watch_over(self, task: asyncio.Task[None]) -> None:
        """A part of the server must not end unnoticed."""
        task.add_done_callback(self._on_task_end)

    def _on_task_end(self, task: asyncio.Task[None]) -> None:
        """An unexpected end of a part of the server: motor to zero, say so, and be unhealthy from then on."""
        if task.cancelled() or not task.exception():
            return
        self.internal_error = f"The server failed inside ({task.exception()!r}). Start the service again."
        logging.getLogger("graspwatch").error("the server failed inside", exc_info=task.exception())
        self.alarms.raise_technical("server", Priority.HIGH, self.internal_error)
        self._stopping = asyncio.create_task(self._commander.send(bus.Stop("the server failed")))

    async def halt(self) -> None:
        """Motor to zero before anything else, and nobody starts anything any more."""
        self._ending = True
        if self.runs.current:
            with contextlib.suppress(ServiceError):  # a worker that does not answer is ended with the others
                await self.stop_run("the service was ended")

    async def stop(self) -> None:
        """Motor to zero, workers ended."""
        try:
            await self.halt()
        finally:
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            await self.supervisor.stop()
            await self.recorder.aclose()
            await self._commander.aclose()
            self._context.destroy(linger=0)
            self._sources.destroy(linger=0)

    # --- commands ----------------------------------------------------------------------------------------------------

    async def start_run(
        self, protocol: Protocol, cycles: int, tissue: str | None, by: str | None, unmeasured: str = ""
    ) -> Run:
        """Start a protocol; a tool that is not armed is armed first, unless the settings forbid it.

        `unmeasured`: why the tool may be armed although its force scale is not measured.

        Raises:
            RefusedError: a fault is latched, the tool cannot be armed, another run began, or the acquisition refuses.
            ServiceError: the acquisition does not answer.
        """
        self.arming.check_fault()
        stops = self._stops
        if self.arming.safety is not Safety.ARMED and self.plan.settings.safety.arm_with_start:
            await self.arming.arm(by, unmeasured)
        if self.arming.unmeasured == CALIBRATING and unmeasured != CALIBRATING:
            raise RefusedError("The tool is armed for a calibration alone. Disarm it first.")
        self._check_free()
        prefix = DEMONSTRATION if self.demo else ""
        run = self.runs.begin(protocol.name, cycles, tissue, by, self._last_tick, prefix)  # nobody else may start now
        self.about.run = run.id
        self.recorder.brief(Brief(run.id, protocol.model_dump_json(), cycles, tissue, by))
        try:
            await self._commander.send(bus.Start(run.id, protocol.model_dump_json(), cycles, tissue))
        except GraspwatchError as error:
            self.runs.forget(run.id)
            self.about.run = None
            if isinstance(error, ServiceError):  # it may yet obey
                with contextlib.suppress(ServiceError):
                    await self._commander.send(bus.Stop("nobody waits for this run any more"))
            raise
        self._keep(run)
        self.simulated_tissue = tissue or self.simulated_tissue
        held = f", {holdable(self.plan.library).tissues[tissue].title.lower()}" if tissue else ""
        self.tell_event(f"Run started: {protocol.title}, {cycles} grasps{held}", JournalKind.RUN, by, run)
        if self._stops != stops:  # the worker may have heard of that before it heard of the start
            await self.stop_run("it was stopped while it began")
        self.tell_state()
        return self.runs.get(run.id) or run

    async def put(self, what: bus.Put) -> None:
        """What a simulated tool's handle and jaws get.

        Raises:
            ServiceError: the acquisition does not answer.
        """
        await self._commander.send(what)

    def _check_free(self) -> None:
        """
        Raises:
            RefusedError: the service ends, or somebody else was faster.
        """
        if self._ending:
            raise RefusedError("The service is being ended: start nothing any more.")
        if self.runs.current:
            raise RefusedError(f"Run {self.runs.current.id} is under way. Stop it first.")

    async def stop_run(self, why: str, who: Callable[[], Awaitable[str | None]] | None = None) -> bool:
        """Motor to zero at once; returns whether a run was stopped. Never refuses. `who` asked for it is found out
        afterwards.

        Raises:
            ServiceError: the acquisition does not answer; its motor is zeroed by the supervisor when it has died.
        """
        if not self.estimator_ready.is_set():
            return False  # there is no motor, or nothing that could move it yet
        self._stops += 1
        effect = await self._commander.send(bus.Stop(why))
        current = self.runs.current
        if effect and current:
            self._end_run(current.id, RunState.STOPPED, why)
        self.tell_event(f"Stopped: the motor is at zero ({why})", JournalKind.RUN, await who() if who else None)
        return effect

    # --- what the workers say ----------------------------------------------------------------------------------------

    async def _listen(self, address: str, take: Callable[[list[bytes]], None]) -> None:
        """Hand what is published at the address to `take`.

        The loop watches the socket itself: a future for each message took as long as what is done with it.
        """
        loop, readable = asyncio.get_running_loop(), asyncio.Event()
        socket = bus.subscriber(self._sources, address)
        loop.add_reader(socket.FD, readable.set)
        readable.set()  # what came before the line above is not told
        try:
            while True:
                await readable.wait()
                readable.clear()
                for _ in range(MOST_AT_A_TIME):
                    if not socket.getsockopt(zmq.EVENTS) & zmq.POLLIN:
                        break
                    take(socket.recv_multipart(zmq.NOBLOCK))
                else:
                    readable.set()
                    await asyncio.sleep(0)
        finally:
            loop.remove_reader(socket.FD)
            socket.close()

    def _on_acquisition(self, parts: list[bytes]) -> None:
        if parts[0] == bus.NOTICE:
            self._on_notice(bus.unpack_notice(parts))
            return
        block = bus.unpack_samples(parts)
        is_alive = block.t_mono_ns > self._died_ns
        if is_alive and self.supervisor.runs("acquisition"):
            self.alarms.end("motor")  # who opens the board writes zero first
            self.tell_state()
        if self._samples.is_out_of_turn(block):
            return
        if self._samples.begins_anew(block.sequence):
            self._joiner.begin_anew()
            self._forget_grasp()
            self.runs.ticks_begin_anew()
        if is_alive and self.arming.follow(block):
            self.tell_state()
        missing = self._samples.take(block.sequence, block.t_mono_ns)
        self._last_tick = int(block.samples["tick"][-1])
        self._limit_n = finite(float(block.samples["limit_n"][-1]))
        self.watchdog.heard("acquisition")
        self._rate.append((time.monotonic(), len(block.samples)))
        self._measure_lateness(block)
        self._tell_lag(block)
        self.metrics.samples.inc(len(block.samples))
        self._count_lost(block.lost_samples + missing * len(block.samples))
        for follow in self.followers:
            follow(block)
        self.metrics.missing_blocks.labels("server").set(self._samples.missing + self._estimates.missing)
        self._joiner.take_samples(block)

    def _measure_lateness(self, block: SampleBlock) -> None:
        """Against the promptest block so far: the sample clock says when each could be read."""
        clock_s = (int(block.samples["tick"][-1]) + 1) / self.plan.tool.board.sample_rate_hz
        behind_s = block.t_mono_ns / 1e9 - clock_s
        if block.sequence == 1:
            self._promptest_s = behind_s
        self._promptest_s = min(self._promptest_s + CLOCK_DRIFT_S, behind_s)
        self.metrics.acquisition_lateness.observe(behind_s - self._promptest_s)

    def _tell_lag(self, block: SampleBlock) -> None:
        """Count samples that are read late; in a run, where the limiter then acts as late, raise an alarm."""
        if block.backlog <= LATE_S * self.plan.tool.board.sample_rate_hz:
            return
        self.metrics.late_blocks.inc()
        if not block.run:
            return
        self._late_s = time.monotonic()
        text = f"Samples are read more than {LATE_S:g} s late, and the limiter acts as late: end other programs"
        self.alarms.raise_technical("late", Priority.MEDIUM, text)

    def _new_teller(self) -> Teller:
        rate_hz = self.plan.tool.board.sample_rate_hz
        return Teller(self.plan.library, rate_hz, self.alarms, self._tell, self._keep_grasp)

    def _tell(self, message: BaseModel) -> None:
        """To the viewers, and to those who keep it."""
        if isinstance(message, Identification):
            self.about.grasp = message.grasp if message.in_grasp else None
        self.hub.broadcast(message)
        self._keep(message)

    def _keep(self, message: BaseModel) -> None:
        self.recorder.tell(message)
        if isinstance(message, Indexed):
            self.index.take(message)

    def _forget_grasp(self) -> None:
        """A worker begins anew: nobody will tell the end of what was under way."""
        self.about.grasp = None
        self.alarms.end_force()
        self._teller = self._new_teller()

    def _on_journal(self, fault: str | None) -> None:
        if fault:
            self.alarms.raise_technical("journal", Priority.LOW, fault)
        else:
            self.alarms.end("journal")

    def _on_index(self, fault: str | None) -> None:
        if fault:
            self.alarms.raise_technical("index", Priority.LOW, fault)
        else:
            self.alarms.end("index")

    def _watch_disk(self) -> None:
        """Once a second: room for what is kept, and samples that were lost or late a while ago."""
        self._free_bytes = free_bytes(self.plan.data)
        if self._free_bytes is None:
            self.alarms.raise_technical("disk", Priority.MEDIUM, f"The data folder {self.plan.data} is gone: mend it")
        elif self._free_bytes < LITTLE_DISK_BYTES:
            full = f"The disk of {self.plan.data} is full: make room, or empty the bin of the recordings"
            self.alarms.raise_technical("disk", Priority.MEDIUM, full)
        else:
            self.alarms.end("disk")
        if time.monotonic() - self._lost_s > LOSS_SHOWN_S:
            self.alarms.end("lost")
        if time.monotonic() - self._late_s > LOSS_SHOWN_S:
            self.alarms.end("late")

    def _watch_calibration(self) -> None:
        if self.plan.opened:
            return
        tool = self.plan.tool
        if expired := tool.expired(date.today()):
            names = ", ".join(f"{each.constant} ({each.expires})" for each in expired)
            text = f"The tool's calibration is expired: {names}. Measure anew before you trust forces"
            self.alarms.raise_technical("calibration", Priority.LOW, text)
        if not tool.has_known_scale:
            text = f"The tool's force scale is not measured ({tool.scale_in_words}): newtons may be wrong by that much"
            self.alarms.raise_technical("scale", Priority.LOW, text)

    def _count_lost(self, samples: int) -> None:
        if samples:
            self.lost_samples += samples
            self._lost_s = time.monotonic()
            self.metrics.lost_samples.inc(samples)
            self.alarms.raise_technical("lost", Priority.LOW, "Samples are being lost: the status strip counts them")

    def _on_estimator(self, parts: list[bytes]) -> None:
        if parts[0] == bus.NOTICE:
            self._on_notice(bus.unpack_notice(parts))
            return
        received = unpack_estimates(parts, len(self.plan.library.tissues))
        block = received.block
        self.watchdog.heard("estimator")
        self._estimates.take(block.sequence)
        self._latency_ms = (received.published_ns - block.t_mono_ns) / 1e6
        self.metrics.estimate_latency.observe(self._latency_ms / 1e3)
        self.metrics.missing_blocks.labels("estimator").set(received.missing_blocks)
        self._joiner.take_estimates(block)
        self._teller.take(block, now_ms(), wall_ms(block.t_mono_ns))

    def _on_notice(self, notice: dict[str, Any]) -> None:
        match notice["kind"]:
            case "compiling":
                self.tell_event("Preparing the filters (compiled on the first start, which takes up to a minute)")
            case "estimating":
                self._fault_texts.pop("estimator", None)
                self.realtime["estimator"] = notice["realtime"]
                if self.supervisor.runs("estimator"):
                    self.watchdog.begins_to_estimate()
                self.estimator_ready.set()
                self.supervisor.open_tool()
            case "acquiring":
                self._fault_texts.pop("acquisition", None)
                self.realtime["acquisition"] = notice["realtime"]
                self.tell_event(f"The tool is acquiring; {notice['realtime']}")
            case "fault":
                self._fault_texts[notice["worker"]] = notice["text"]
                self.alarms.raise_technical(notice["worker"], Priority.HIGH, notice["text"])
            case "stalled":
                self.tell_event(notice["text"])
            case "let_go":
                self.alarms.happened("let-go", AlarmKind.FORCE, notice["text"])
            case "run_ended":
                self._end_run(notice["run_id"], RunState(notice["end"]), notice["why"])
        self.tell_state()

    def _on_recorder(self, parts: list[bytes]) -> None:
        self.watchdog.heard("recorder")
        self.supervisor.runs("recorder")
        before = self.recorder.state.file
        notice = bus.unpack_notice(parts)
        if "realtime" in notice:
            self.realtime["recorder"] = notice["realtime"]
        self.recorder.heard(notice)
        if self.recorder.state.file != before:
            self.tell_state()

    def _on_guard(self, parts: list[bytes]) -> None:
        self.watchdog.heard("guard")
        self.supervisor.runs("guard")
        notice = bus.unpack_notice(parts)
        match notice["kind"]:
            case "guarding":
                self.realtime["guard"] = notice["realtime"]
            case "zeroed":
                self._on_motor(None)
                self.alarms.raise_technical("samples", Priority.HIGH, notice["text"])
            case "not_zeroed":
                self._on_motor(notice["text"])

    def _on_foxglove(self, parts: list[bytes]) -> None:
        if self.supervisor.runs("foxglove"):
            self.alarms.end("foxglove")
            self.tell_state()

    def _on_motor(self, fault: str | None) -> None:
        """Whether the motor that nobody drives any more could be brought to zero."""
        if fault:
            self.alarms.raise_technical("motor", Priority.HIGH, fault)
        else:
            self.alarms.end("motor")

    def _keep_grasp(self, grasp: Grasp) -> None:
        self.metrics.grasps.labels(grasp.label).inc()
        run_id, grasp = self.runs.keep(grasp, round(grasp.start_s * self.plan.tool.board.sample_rate_hz))
        self._tell(GraspEnded(run_id=run_id, grasp=grasp))

    def _end_run(self, run_id: str, state: RunState, why: str) -> None:
        if not self.runs.end(run_id, state, why):
            return
        ended = self.runs.get(run_id)
        if ended:
            self._keep(ended)
        self.tell_event(f"Run {state.value}: {why}", JournalKind.RUN, run=ended)
        self.about.run = None
        if state is not RunState.FINISHED:
            self.demo = None
        self.tell_state()

    def _on_death(self, worker: str, text: str) -> None:
        self.metrics.worker_deaths.labels(worker).inc()
        if worker == "recorder":
            self.recorder.died(text)
            self.tell_state()
            return
        if worker == "foxglove":
            self.alarms.raise_technical(worker, Priority.LOW, text)
            return
        if worker == "guard":
            self.alarms.raise_technical(worker, Priority.HIGH, f"{text} A hung acquisition would be noticed late")
            return
        self._forget_grasp()
        text = " ".join(filter(None, (self._fault_texts.pop(worker, None), text)))
        self.alarms.raise_technical(worker, Priority.HIGH, text)
        self.tell_event(text)
        current = self.runs.current
        if worker == "acquisition":
            self._died_ns = time.monotonic_ns()
            self.arming.died("the acquisition worker died")
            if current:
                self._end_run(current.id, RunState.FAILED, "the acquisition worker died")
        self.tell_state()

    async def _show_life(self, address: str) -> None:
        """Tell the acquisition that the event loop, which carries STOP, goes round. Belongs into no other thread."""
        signs = bus.publisher(self._context, address)
        try:
            while True:
                asked_s = time.monotonic()
                await signs.send(b"")
                await asyncio.sleep(SIGN_OF_LIFE_S)
                self.metrics.server_delay.observe(max(time.monotonic() - asked_s - SIGN_OF_LIFE_S, 0.0))
        finally:
            signs.close()

    # --- what the viewers get ----------------------------------------------------------------------------------------

    async def _tick(self) -> None:
        """Cut frames at a steady rate; once a second tell the state; watch for silence."""
        period_s = 1.0 / self.plan.settings.server.frame_rate_hz
        due, told_s = time.monotonic(), 0.0
        while True:
            due += period_s
            await asyncio.sleep(max(due - time.monotonic(), 0.0))
            asked = due
            due = max(due, time.monotonic() - period_s)
            self._joiner.join()
            for frame in self._frames.cut():
                self.hub.broadcast_frame(frame)
            self.watchdog.watch(max(time.monotonic() - asked, 0.0))
            if time.monotonic() - told_s >= 1.0:
                told_s = time.monotonic()
                self._priority.renew()
                self._watch_disk()
                self._watch_calibration()
                self.control.renew(self.runs.current.by if self.runs.current else None)
                self.tell_state()

    def measured(self) -> bytes:
        """As Prometheus reads it."""
        self.metrics.phase.state(self.phase.value)
        self.metrics.tell_alarms(self.alarms.all())
        self.metrics.free_disk.set(float("nan") if self._free_bytes is None else self._free_bytes)
        self.metrics.recording.set(self.recorder.state.file is not None)
        self.metrics.viewers.set(len(self.hub.viewers))
        self.metrics.index_left_out.set(self.index.left_out)
        return self.metrics.text()

    def conditions(self) -> dict[str, str]:
        """How each worker is; a service without a tool has none."""
        if self.plan.opened:
            return {}
        return {name: worker.condition.value for name, worker in self.supervisor.workers.items()}

    @property
    def phase(self) -> Phase:
        if self.plan.opened:
            return Phase.REPLAY
        needed = {"acquisition", "estimator"} if self.runs.current else {"acquisition", "estimator", "guard"}
        conditions = {each.condition for name, each in self.supervisor.workers.items() if name in needed}
        if self.internal_error or Condition.FAULTED in conditions:
            return Phase.FAULTED
        if conditions != {Condition.RUNNING} or not self.watchdog.sampling:
            return Phase.STARTING
        return Phase.RUNNING if self.runs.current else Phase.IDLE

    def _rate_hz(self) -> float:
        if len(self._rate) < 2 or time.monotonic() - self._rate[-1][0] > 1.0:
            return 0.0
        return sum(n for _, n in list(self._rate)[1:]) / (self._rate[-1][0] - self._rate[0][0])

    def state(self) -> State:
        return State(
            server_time_ms=now_ms(),
            phase=self.phase,
            safety=self.arming.safety,
            safety_why=self.arming.why or None,
            run=self.runs.current,
            last_run=self.runs.last,
            limit_n=self._limit_n,
            simulated_tissue=self.simulated_tissue,
            demo=self.demo,
            control=self._control(),
            rate_hz=self._rate_hz(),
            lost_samples=self.lost_samples,
            estimator_latency_ms=self._latency_ms,
            viewers=len(self.hub.viewers),
            recording=self.recorder.state,
            free_disk_bytes=self._free_bytes,
            faults=self.alarms.technical_texts(),
        )

    def tell_state(self) -> None:
        self.hub.broadcast(self.state())

    def give_back_control(self, name: str) -> bool:
        """False: he did not have it."""
        if not self.control.release(name):
            return False
        self.tell_event("Control given back", JournalKind.ACCESS, name)
        self.tell_state()
        return True

    def _control(self) -> str | None:
        if self.control.holder:
            return self.control.holder
        run = self.runs.current
        if run is None:
            return None
        return "the demonstration" if self.demo else run.by or "somebody without a name"

    def tell_event(
        self, text: str, kind: JournalKind = JournalKind.EVENT, by: str | None = None, run: Run | None = None
    ) -> None:
        """To the viewers and the journal."""
        self.journal.write(kind, text, by=by, run=run)
        self.hub.broadcast(EventMessage(server_time_ms=now_ms(), text=f"{text}, by {by}" if by else text))

    def greeting(self) -> tuple[list[Any], list[bytes]]:
        """What a new viewer gets first: messages, and the last seconds of samples."""
        plan = self.plan
        messages: list[Any] = [hello(plan, plan.tool, recording=bool(plan.opened)), self.state(), *self.alarms.all()]
        run = self.runs.last
        if run:
            messages += [GraspEnded(run_id=run.id, grasp=grasp) for grasp in self.runs.grasps(run.id)[-GRASPS_TOLD:]]
        if self._teller.identification:
            messages.append(self._teller.identification)
        return messages, self._frames.history()
