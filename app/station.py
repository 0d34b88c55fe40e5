"""The server's picture of the tool: follows the bus, keeps runs and alarms, tells the viewers, passes commands on."""

import asyncio
import contextlib
import logging
import time
from collections import deque
from dataclasses import asdict
from typing import Any

import numpy as np
import zmq
import zmq.asyncio

from acquisition import bus
from acquisition.blocks import SampleBlock
from app import __version__
from app.alarms import FORCE, AlarmBook
from app.frames import FrameBuffer, channels, columns_of
from app.live import Hub
from app.metrics import Metrics
from app.plan import ServicePlan
from app.runs import RunBook
from app.supervisor import Condition, Supervisor
from app.wire import (
    EventMessage,
    Grasp,
    GraspEnded,
    Hello,
    Identification,
    Phase,
    Priority,
    Run,
    RunState,
    State,
    TissueInfo,
    ToolInfo,
    ToolKind,
)
from config.errors import ServiceError
from config.schema import Protocol
from estimator.blocks import blank_estimates, estimate_dtype
from estimator.worker import ReceivedEstimates, unpack_estimates

ANSWER_S = 0.5
ANSWERS_KEPT = 400  # blocks: two seconds
ESTIMATES_LATE_S = 0.1  # samples are shown without estimates when these take longer
CLOCK_DRIFT_S = 5e-7  # a block: 100 ppm between the board's clock and the computer's
HUNG_S = 2.0  # a worker silent for longer is killed and replaced
SILENCE_S = 0.25
IDENTIFICATIONS_HZ = 10.0


CLOCK_OFFSET_MS = time.time() * 1e3 - time.monotonic() * 1e3


def now_ms() -> float:
    """Milliseconds since 1970 on a clock that is never stepped."""
    return time.monotonic() * 1e3 + CLOCK_OFFSET_MS


class Station:
    """One tool, its runs, its viewers."""

    def __init__(self, plan: ServicePlan) -> None:
        self.plan = plan
        self.metrics = Metrics()
        self.hub = Hub(plan.settings.server.chart_window_frames)
        self.alarms = AlarmBook(self.hub.broadcast)
        self.supervisor = Supervisor(plan, self._on_death)
        self.runs = RunBook()
        self.demonstrating = plan.demo
        self.internal_error: str | None = None
        self.simulated_tissue = plan.tissue if plan.tool.kind is ToolKind.SIMULATED and not plan.recordings else None
        self._context = zmq.asyncio.Context()
        self._tasks: list[asyncio.Task[None]] = []
        self._tissues = list(plan.library.tissues)
        history = int(plan.settings.server.history_s * plan.tool.board.sample_rate_hz)
        self._frames = FrameBuffer(history)
        self._waiting: deque[tuple[float, SampleBlock]] = deque()  # when it came, s; its estimates are still to come
        self._answers: dict[int, np.ndarray] = {}  # estimates whose samples are still to come
        self._samples = bus.SequenceCounter()
        self._estimates = bus.SequenceCounter()
        self._last_sample_s = 0.0
        self._last_estimate_s = 0.0
        self._rate: deque[tuple[float, int]] = deque(maxlen=400)
        self._promptest_s = float("inf")
        self._latency_ms: float | None = None
        self.lost_samples = 0
        self._identification: Identification | None = None
        self._told_s = 0.0
        self._recording_ended = False
        self._sampling = False
        self._last_tick = -1
        self._fault_texts: dict[str, str] = {}
        self._watch_from_s = 0.0
        self.estimator_ready = asyncio.Event()

    # --- life --------------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Start the workers: first the estimator, whose filters may have to be compiled, then the tool."""
        endpoints = self.supervisor.endpoints
        for work in (
            self._listen(endpoints.estimates, self._on_estimator),
            self._listen(endpoints.samples, self._on_acquisition),
            self._tick(),
            self._start_tool(),
        ):
            task = asyncio.create_task(work)
            task.add_done_callback(self._on_task_end)
            self._tasks.append(task)
        self.supervisor.start_estimator()

    def _on_task_end(self, task: asyncio.Task[None]) -> None:
        """An unexpected end of a part of the server: motor to zero, say so, and be unhealthy from then on."""
        if task.cancelled() or not task.exception():
            return
        self.internal_error = f"The server failed inside ({task.exception()!r}). Start the service again."
        logging.getLogger("graspwatch").error("the server failed inside", exc_info=task.exception())
        self.alarms.raise_technical("server", Priority.HIGH, self.internal_error)
        self._stopping = asyncio.create_task(self._command(bus.Stop("the server failed")))

    async def _start_tool(self) -> None:
        await self.estimator_ready.wait()
        self.supervisor.start_acquisition()

    async def stop(self) -> None:
        """Motor to zero, workers ended."""
        try:
            if self.runs.current:
                with contextlib.suppress(ServiceError):  # a worker that does not answer is ended below
                    await self.stop_run("the service was ended")
        finally:
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            await self.supervisor.stop()
            self._context.destroy(linger=0)

    # --- commands ----------------------------------------------------------------------------------------------------

    async def start_run(self, protocol: Protocol, cycles: int, tissue: str | None) -> Run:
        """Start a protocol.

        Raises:
            ServiceError: the acquisition does not answer or refuses; the text says why.
        """
        run = self.runs.begin(protocol.name, cycles, tissue, self._last_tick)  # nobody else may start meanwhile
        deadline_ns = time.monotonic_ns() + int(ANSWER_S * 1e9)
        answer = await self._command(bus.Start(run.id, protocol.model_dump_json(), cycles, tissue, deadline_ns))
        if answer.refused:
            self.runs.forget(run.id)
            raise ServiceError(answer.refused)
        self.alarms.end("run")
        self.simulated_tissue = tissue or self.simulated_tissue
        held = f", {self.plan.library.tissues[tissue].title.lower()}" if tissue else ""
        self._event(f"Run started: {protocol.title}, {cycles} grasps{held}")
        self.tell_state()
        return run

    async def stop_run(self, why: str) -> bool:
        """Motor to zero at once; returns whether a run was stopped. Never refuses.

        Raises:
            ServiceError: the acquisition does not answer; its motor is zeroed by the supervisor when it has died.
        """
        if self.plan.recordings or self.supervisor.workers["acquisition"].process is None:
            return False  # there is no motor, or nothing that could move it yet
        answer = await self._command(bus.Stop(why))
        if answer.refused:
            raise ServiceError(answer.refused)
        current = self.runs.current
        if answer.effect and current:
            self._end_run(current.id, RunState.STOPPED, why)
        self._event("Stopped: the motor is at zero" + (f" ({why})" if why else ""))
        return answer.effect

    async def _command(self, command: bus.Command) -> bus.Answer:
        socket = self._context.socket(zmq.REQ)
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(self.supervisor.endpoints.commands)
        try:
            await socket.send(bus.pack_command(command))
            return bus.unpack_answer(await asyncio.wait_for(socket.recv(), ANSWER_S))
        except TimeoutError:
            return bus.Answer(refused="The acquisition worker does not answer. See the alarms, then try again.")
        finally:
            socket.close()

    # --- what the workers say ----------------------------------------------------------------------------------------

    async def _listen(self, address: str, take: Any) -> None:
        socket = bus.subscriber(self._context, address)
        try:
            while True:
                take(await socket.recv_multipart())
        finally:
            socket.close()

    def _on_acquisition(self, parts: list[bytes]) -> None:
        if parts[0] == bus.NOTICE:
            self._on_notice(bus.unpack_notice(parts))
            return
        block = bus.unpack_samples(parts)
        now = time.monotonic()
        if self.supervisor.workers["acquisition"].condition is Condition.STARTING:
            self.supervisor.workers["acquisition"].condition = Condition.RUNNING
            self.tell_state()
        if self._samples.begins_anew(block.sequence):
            self._answers.clear()
            self.runs.ticks_begin_anew()
        missing = self._samples.take(block.sequence)
        self._last_tick = int(block.samples["tick"][-1])
        self._last_sample_s = now
        self._rate.append((now, len(block.samples)))
        self._measure_lateness(block)
        self.metrics.samples.inc(len(block.samples))
        self._count_lost(block.lost_samples + missing * len(block.samples))
        self.metrics.missing_blocks.labels("server").set(self._samples.missing + self._estimates.missing)
        self._waiting.append((now, block))

    def _measure_lateness(self, block: SampleBlock) -> None:
        """Against the promptest block so far: the sample clock says when each could be read."""
        clock_s = (int(block.samples["tick"][-1]) + 1) / self.plan.tool.board.sample_rate_hz
        behind_s = block.t_mono_ns / 1e9 - clock_s
        if block.sequence == 1:
            self._promptest_s = behind_s
        self._promptest_s = min(self._promptest_s + CLOCK_DRIFT_S, behind_s)
        self.metrics.acquisition_lateness.observe(behind_s - self._promptest_s)

    def _count_lost(self, samples: int) -> None:
        if samples:
            self.lost_samples += samples
            self.metrics.lost_samples.inc(samples)
            self.alarms.raise_technical("lost", Priority.LOW, f"{self.lost_samples} samples lost so far")

    def _on_estimator(self, parts: list[bytes]) -> None:
        if parts[0] == bus.NOTICE:
            self._on_notice(bus.unpack_notice(parts))
            return
        received = unpack_estimates(parts, len(self._tissues))
        self._last_estimate_s = time.monotonic()
        self._estimates.take(received.block.sequence)
        self._latency_ms = (received.published_ns - received.block.t_mono_ns) / 1e6
        self.metrics.estimate_latency.observe(self._latency_ms / 1e3)
        self.metrics.missing_blocks.labels("estimator").set(received.missing_blocks)
        self._answers[received.block.sequence] = received.block.estimates
        self._answers.pop(received.block.sequence - ANSWERS_KEPT, None)
        self._join()
        self._tell(received)

    def _on_notice(self, notice: dict[str, Any]) -> None:
        match notice["kind"]:
            case "compiling":
                self._event("Preparing the filters (compiled on the first start, which takes up to a minute)")
            case "estimating":
                self.supervisor.workers["estimator"].condition = Condition.RUNNING
                self.estimator_ready.set()
            case "acquiring":
                self._event("The tool is acquiring" + ("" if notice["realtime"] else ", without real-time priority"))
            case "recording":
                self._event(f"Replaying {notice['name']}")
            case "ended":
                self._recording_ended = True
                self.alarms.end(FORCE)
                self._event("The recording has ended")
            case "fault":
                self._fault_texts[notice["worker"]] = notice["text"]
                self.alarms.raise_technical(notice["worker"], Priority.HIGH, notice["text"])
            case "run_ended":
                self._end_run(notice["run_id"], RunState(notice["end"]), notice["why"])
        self.tell_state()

    def _join(self) -> None:
        """Put samples and their estimates together, whichever came first; samples go without when theirs are late."""
        while self._waiting:
            came_s, block = self._waiting[0]
            estimates = self._answers.pop(block.sequence, None)
            if estimates is None:
                overtaken = bool(self._answers) and block.sequence < min(self._answers)
                if not overtaken and time.monotonic() - came_s < ESTIMATES_LATE_S:
                    return
                estimates = blank_estimates(estimate_dtype(len(self._tissues)), block.samples["tick"])
            self._waiting.popleft()
            columns = columns_of(block.samples, estimates, len(self._tissues))
            newest_ms = block.t_mono_ns / 1e6 + CLOCK_OFFSET_MS
            self._frames.add(int(block.samples["tick"][0]), columns, newest_ms)

    def _tell(self, received: ReceivedEstimates) -> None:
        """Identification, withdrawn names, finished grasps and force alarms to the viewers."""
        block = received.block
        message = Identification(server_time_ms=now_ms(), **asdict(block.identification))
        before, self._identification = self._identification, message
        changed = before is None or (before.label, before.in_grasp, before.grasp) != (
            message.label, message.in_grasp, message.grasp,
        )  # fmt: skip
        due = message.in_grasp and time.monotonic() - self._told_s > 1.0 / IDENTIFICATIONS_HZ
        if changed or due:
            self._told_s = time.monotonic()
            self.hub.broadcast(message)
        for withdrawal in block.withdrawn:
            reason = withdrawal.why or f"{100 * withdrawal.probability:.0f} % now"
            self._event(f"{self._title(withdrawal.label)} withdrawn: {reason}")
        for alarm in block.alarms:
            self.alarms.force(alarm)
        for record in block.ended:
            self._keep_grasp(Grasp(**asdict(record)))

    def _title(self, label: str) -> str:
        profile = self.plan.library.tissues.get(label)
        return profile.title if profile else label.capitalize()

    def _keep_grasp(self, grasp: Grasp) -> None:
        self.metrics.grasps.labels(grasp.label).inc()
        run_id, grasp = self.runs.keep(grasp, round(grasp.start_s * self.plan.tool.board.sample_rate_hz))
        self.hub.broadcast(GraspEnded(run_id=run_id, grasp=grasp))

    def _end_run(self, run_id: str, state: RunState, why: str) -> None:
        if not self.runs.end(run_id, state, why):
            return
        self._event(f"Run {state.value}: {why}")
        if state is RunState.FAILED:
            self.alarms.raise_technical("run", Priority.HIGH, f"The run was ended with the motor at zero: {why}")
        if state is not RunState.FINISHED:
            self.demonstrating = False
        self.tell_state()

    def _on_death(self, worker: str, text: str) -> None:
        """A worker died, or (`motor`) the motor of a dead one could not be brought to zero."""
        if worker == "motor":
            self.alarms.raise_technical("motor", Priority.HIGH, text)
            return
        self.metrics.worker_deaths.labels(worker).inc()
        text = " ".join(filter(None, (self._fault_texts.pop(worker, None), text)))
        self.alarms.raise_technical(worker, Priority.HIGH, text)
        self._event(text)
        current = self.runs.current
        if worker == "acquisition" and current:
            self._end_run(current.id, RunState.FAILED, "the acquisition worker died")
        self.tell_state()

    # --- what the viewers get ----------------------------------------------------------------------------------------

    async def _tick(self) -> None:
        """Cut frames at a steady rate; once a second tell the state; watch for silence."""
        period_s = 1.0 / self.plan.settings.server.frame_rate_hz
        due, told_s = time.monotonic(), 0.0
        while True:
            due += period_s
            await asyncio.sleep(max(due - time.monotonic(), 0.0))
            if time.monotonic() - due > SILENCE_S:  # this process was held up: let it read what waits before it judges
                self._watch_from_s = time.monotonic() + HUNG_S
            due = max(due, time.monotonic() - period_s)
            self._join()
            for frame in self._frames.cut():
                self.hub.broadcast_frame(frame)
            self.metrics.viewers.set(len(self.hub.viewers))
            self._watch()
            if time.monotonic() - told_s >= 1.0:
                told_s = time.monotonic()
                self.tell_state()

    def _watch(self) -> None:
        """Raise a technical alarm while a worker is silent, and end it when it speaks again."""
        now = time.monotonic()
        alive = {name: worker.condition is Condition.RUNNING for name, worker in self.supervisor.workers.items()}
        silent_s = {"acquisition": now - self._last_sample_s, "estimator": now - self._last_estimate_s}
        if self._recording_ended or now < self._watch_from_s:
            return
        self._sampling = silent_s["acquisition"] < SILENCE_S
        estimating = silent_s["estimator"] < SILENCE_S
        if self._last_sample_s and not self._sampling:
            self.alarms.raise_technical("samples", Priority.HIGH, "No samples arrive from the tool")
        elif self._sampling and alive["acquisition"]:
            self.alarms.end("samples")
            self.alarms.end("acquisition")
        if self._last_estimate_s and self._sampling and not estimating:
            self.alarms.raise_technical("estimates", Priority.MEDIUM, "No estimates arrive: the tissue is not watched")
        elif estimating and alive["estimator"]:
            self.alarms.end("estimates")
            self.alarms.end("estimator")
        for name, since_s in silent_s.items():
            expected = name == "acquisition" or self._sampling
            if alive[name] and expected and since_s > HUNG_S and not self.plan.recordings:
                self._event(f"The {name} worker does not answer: it is ended and replaced")
                self.supervisor.kill(name)

    @property
    def phase(self) -> Phase:
        conditions = {name: worker.condition for name, worker in self.supervisor.workers.items()}
        if self.internal_error or Condition.FAULTED in conditions.values():
            return Phase.FAULTED
        if self._recording_ended:
            return Phase.ENDED
        if set(conditions.values()) != {Condition.RUNNING} or not self._sampling:
            return Phase.STARTING
        if self.plan.recordings:
            return Phase.REPLAYING
        return Phase.RUNNING if self.runs.current else Phase.IDLE

    def _rate_hz(self) -> float:
        if len(self._rate) < 2 or time.monotonic() - self._rate[-1][0] > 1.0:
            return 0.0
        return sum(n for _, n in list(self._rate)[1:]) / (self._rate[-1][0] - self._rate[0][0])

    def state(self) -> State:
        return State(
            server_time_ms=now_ms(),
            phase=self.phase,
            run=self.runs.current,
            last_run=self.runs.last,
            simulated_tissue=self.simulated_tissue,
            demo=self.demonstrating,
            rate_hz=self._rate_hz(),
            lost_samples=self.lost_samples,
            estimator_latency_ms=self._latency_ms,
            viewers=len(self.hub.viewers),
            faults=self.alarms.technical_texts(),
        )

    def tell_state(self) -> None:
        self.hub.broadcast(self.state())

    def _event(self, text: str) -> None:
        self.hub.broadcast(EventMessage(server_time_ms=now_ms(), text=text))

    def hello(self) -> Hello:
        library, shares = self.plan.library, self.plan.settings.warnings
        return Hello(
            version=__version__,
            server_time_ms=now_ms(),
            tool=self.tool_info(),
            library=library.name,
            tissues=self.tissue_infos(),
            lowest_threshold_n=library.lowest_threshold_n,
            warning_shares=[shares.low, shares.medium, shares.high],
            channels=channels(self._tissues),
            frame_rate_hz=self.plan.settings.server.frame_rate_hz,
        )

    def greeting(self) -> tuple[list[Any], list[bytes]]:
        """What a new viewer gets first: messages, and the last seconds of samples."""
        messages: list[Any] = [self.hello(), self.state(), *self.alarms.active()]
        run = self.runs.last
        if run:
            messages += [GraspEnded(run_id=run.id, grasp=grasp) for grasp in self.runs.grasps(run.id)]
        if self._identification:
            messages.append(self._identification)
        return messages, self._frames.history()

    def tool_info(self) -> ToolInfo:
        tool = self.plan.tool
        return ToolInfo(
            name=tool.name,
            title=tool.title,
            kind=ToolKind.RECORDING if self.plan.recordings else tool.kind,
            sample_rate_hz=tool.board.sample_rate_hz,
            max_command_v=tool.limits.max_command_v,
            force_ceiling_n=tool.limits.force_ceiling_n,
            calibration_date=tool.calibration.date,
        )

    def tissue_infos(self) -> list[TissueInfo]:
        library = self.plan.library
        return [
            TissueInfo(
                name=name, title=profile.title, alpha_n=profile.alpha_n, beta_per_m=profile.beta_per_m,
                damping_kg_per_s=profile.damping_kg_per_s, thickness_m=profile.thickness_m,
                threshold_n=library.threshold_n(name),
            )
            for name, profile in library.tissues.items()
        ]  # fmt: skip
