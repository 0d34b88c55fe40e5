"""The class RunController: starts runs, stops the motor on request, and records how each run ended."""

import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import replace

from acquisition import bus
from acquisition.notices import RunMetadata
from acquisition.recordings.file_names import DEMO_ID_PREFIX, REFERENCE_ID_PREFIX
from acquisition.safety_state_machine import Safety
from app.host.logs import LogContext
from app.messages.journal import JournalKind
from app.messages.runs import Run, RunState
from app.service.annotations import Annotations
from app.service.arming import CALIBRATION_ARM_REASON, ArmingController
from app.service.commander import Commander
from app.service.lab_sessions import LabSessions
from app.service.publisher import Publisher
from app.service.reference_grasps import ReferenceGrasps
from app.service.runs import RunRegistry, RunUnderWayError
from app.service.sample_monitor import SampleMonitor
from app.service.state_reporter import StateReporter
from app.service.supervisor import Supervisor
from config.errors import GraspwatchError, RefusedError, ServiceError
from config.load import build_graspable_library
from config.schema import GraspProtocol
from config.service_plan import ServicePlan


class RunController:
    """Controller that starts, stops and ends runs."""

    def __init__(
        self,
        plan: ServicePlan,
        publisher: Publisher,
        commander: Commander,
        supervisor: Supervisor,
        arming: ArmingController,
        runs: RunRegistry,
        sample_monitor: SampleMonitor,
        references: ReferenceGrasps,
        annotations: Annotations,
        lab_sessions: LabSessions,
        state: StateReporter,
        log_context: LogContext,
    ) -> None:
        self._plan, self._publisher, self._commander, self._supervisor = plan, publisher, commander, supervisor
        self._arming, self._runs, self._sample_monitor, self._state = arming, runs, sample_monitor, state
        self._references, self._annotations, self._log_context = references, annotations, log_context
        self._lab_sessions = lab_sessions
        self._shutting_down = False
        self._stop_count = 0

    async def start(
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
        stops = self._stop_count
        await self._arming.wait_until_known()
        self._arming.check_no_fault()
        self._lab_sessions.require_session_under_way(self._plan.tool.kind)
        is_unarmed = self._plan.tool.has_motor and self._arming.safety is not Safety.ARMED
        if is_unarmed and self._plan.settings.safety.arm_with_start:
            await self._arming.arm(by, unmeasured_scale_reason)
        self._check_can_start(unmeasured_scale_reason)
        prefix = DEMO_ID_PREFIX if self._runs.demo_text else ""
        if protocol.is_reference_grasp:
            prefix, tissue = REFERENCE_ID_PREFIX, None
        # refuses every other start from here on
        session = None if self._runs.demo_text else self._lab_sessions.current
        session_id = session.id if session else None
        run = self._runs.begin(protocol.name, cycles, tissue, by, self._sample_monitor.last_tick, prefix, session_id)
        self._log_context.run = run.id
        reference = None if protocol.is_reference_grasp else self._references.find_valid()
        announced = RunMetadata(run.id, protocol.model_dump_json(), cycles, tissue, by)
        if reference:
            announced = replace(announced, reference=reference.model_dump_json())
        if session:
            announced = replace(announced, session=session.model_dump_json())
        self._publisher.announce_run(announced)
        await self._send_start(bus.StartCommand(run.id, protocol.model_dump_json(), cycles, tissue))
        self._publisher.record(run)
        self._runs.simulated_tissue = tissue or self._runs.simulated_tissue
        held = f", {build_graspable_library(self._plan.library).tissues[tissue].title.lower()}" if tissue else ""
        grasps = f", {cycles} grasps" if self._plan.tool.has_motor else ""
        text = f"Run started: {protocol.title}{grasps}{held}"
        self._publisher.publish_event(text, JournalKind.RUN, by, run)
        if self._stop_count != stops:  # the acquisition may have received the stop before the start
            await self.stop("it was stopped while it began")
        self._state.publish()
        return self._runs.get(run.id) or run

    def _check_can_start(self, unmeasured_scale_reason: str) -> None:
        """Check that the tool is armed for this run, the service is not ending, and no run is under way.

        Raises:
            RefusedError: one of them is not so; the text says which.
        """
        if (
            self._arming.unmeasured_scale_reason == CALIBRATION_ARM_REASON
            and unmeasured_scale_reason != CALIBRATION_ARM_REASON
        ):
            raise RefusedError("The tool is armed for a calibration alone. Disarm it first.")
        if self._shutting_down:
            raise RefusedError("The service is being ended: start nothing any more.")
        if self._runs.current:
            raise RunUnderWayError(self._runs.current)

    async def _send_start(self, command: bus.StartCommand) -> None:
        """Send the start to the acquisition, and discard the run if that fails."""
        try:
            await self._commander.send(command)
        except GraspwatchError as error:
            self._runs.discard(command.run_id)
            self._log_context.run = None
            if isinstance(error, ServiceError):  # the acquisition may still obey
                with contextlib.suppress(ServiceError):
                    await self._commander.send(bus.StopCommand("nobody waits for this run any more"))
            raise

    async def stop(self, why: str, find_requester: Callable[[], Awaitable[str | None]] | None = None) -> bool:
        """Bring the motor to zero at once, and return whether a run was stopped. A stop is never refused.

        `find_requester` returns the requester's name; it is awaited after the stop, which it cannot delay.

        Raises:
            ServiceError: the acquisition does not answer; if it has died, the supervisor zeroes the motor.
        """
        if not self._supervisor.tool_may_open:
            return False  # no motor exists, or no worker can move it yet
        self._stop_count += 1
        effect = await self._commander.send(bus.StopCommand(why))
        current = self._runs.current
        if effect and current:
            self.end(current.id, RunState.STOPPED, why)
        by = await find_requester() if find_requester else None
        at_zero = ": the motor is at zero" if self._plan.tool.has_motor else ""
        self._publisher.publish_event(f"Stopped{at_zero} ({why})", JournalKind.RUN, by)
        return effect

    async def begin_spot(self, by: str | None) -> Run:
        """Begin a new spot in the run under way, and return the run.

        Raises:
            RefusedError: no run is under way.
            ServiceError: the acquisition does not answer.
        """
        await self._commander.send(bus.BeginSpotCommand())
        run = self._runs.current
        if run is None:
            raise RefusedError("The run has just ended. Each run begins a new spot.")
        self._annotations.on_new_spot()
        self._state.publish()  # at once: what counted for the spot before is stated no more
        self._publisher.publish_event("A new spot begins", JournalKind.RUN, by, run)
        return run

    async def halt(self) -> None:
        """Stop the run under way, and refuse every start from now on."""
        self._shutting_down = True
        if self._runs.current:
            with contextlib.suppress(ServiceError):  # `ToolService.stop` ends a worker that does not answer
                await self.stop("the service was ended")

    def end(self, run_id: str, state: RunState, why: str) -> None:
        """Mark a run as ended in `state`, if it is the one under way."""
        if not self._runs.end(run_id, state, why):
            return
        ended = self._runs.get(run_id)
        self._annotations.on_run_end()
        if ended:
            self._publisher.record(ended)
            self._references.on_run_end(ended)
        self._publisher.publish_event(f"Run {state.value}: {why}", JournalKind.RUN, run=ended)
        self._log_context.run = None
        if state is not RunState.FINISHED:
            self._runs.demo_text = None
        self._state.publish()

    def fail_current(self, why: str) -> None:
        """End the run under way as failed, if there is one."""
        if self._runs.current:
            self.end(self._runs.current.id, RunState.FAILED, why)


def fail_interrupted_runs(publisher: Publisher) -> None:
    """Mark runs that a killed service left open as failed.

    If another service uses the same index, the runs may belong to it and stay open.
    """
    store = publisher.index_writer.store
    for run in store.find_unfinished_runs() if store.had_no_other_user else []:
        why = "the service was ended from outside during the run"
        run = run.model_copy(update={"state": RunState.FAILED, "why": why})
        publisher.journal.write(JournalKind.RUN, f"Run {run.id} failed: {why}", run=run)
