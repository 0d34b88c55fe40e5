"""The class StateReporter, which builds the service's state message, and reports the service's phase and metrics."""

from dataclasses import dataclass

from app.host.clock import now_ms
from app.messages.live import Phase, State
from app.service.annotations import Annotations
from app.service.arming import ArmingController
from app.service.condition_checks import ConditionChecks
from app.service.control_lease import ControlLease
from app.service.lab_sessions import LabSessions
from app.service.metrics import Metrics
from app.service.publisher import Publisher
from app.service.recorder_link import RecorderLink
from app.service.reference_grasps import ReferenceGrasps
from app.service.runs import RunRegistry
from app.service.sample_monitor import SampleMonitor
from app.service.supervisor import Supervisor
from app.service.task_watch import TaskWatch
from app.service.watchdog import Watchdog
from app.service.workers import WorkerCondition


@dataclass(frozen=True, slots=True)
class StateReporter:
    """Reporter that reads the other parts and changes none.

    `is_replay`: the service has no tool and shows recordings only.
    """

    publisher: Publisher
    supervisor: Supervisor
    watchdog: Watchdog
    tasks: TaskWatch
    runs: RunRegistry
    arming: ArmingController
    control_lease: ControlLease
    sample_monitor: SampleMonitor
    recorder_link: RecorderLink
    checks: ConditionChecks
    references: ReferenceGrasps
    annotations: Annotations
    lab_sessions: LabSessions
    metrics: Metrics
    is_replay: bool

    def publish(self) -> None:
        """Send the state to all viewers."""
        self.publisher.viewer_hub.broadcast(self.build())

    def build(self) -> State:
        """Build the message that describes the present state."""
        return State(
            server_time_ms=now_ms(),
            phase=self.phase,
            safety=self.arming.safety,
            safety_why=self.arming.why or None,
            run=self.runs.current,
            last_run=self.runs.last,
            limit_n=self.sample_monitor.limit_n,
            simulated_tissue=self.runs.simulated_tissue,
            demo=self.runs.demo_text,
            control=self._control_holder(),
            rate_hz=self.sample_monitor.rate_hz,
            lost_samples=self.sample_monitor.lost_samples,
            estimator_latency_ms=self.sample_monitor.estimate_latency_ms,
            viewers=len(self.publisher.viewer_hub.viewers),
            recording=self.recorder_link.state,
            reference=self.references.build_state(),
            stated=self.annotations.statement,
            session=self.lab_sessions.current,
            free_disk_bytes=self.checks.free_disk_bytes,
            faults=self.publisher.alarms.technical_alarm_texts(),
            event_number=self.publisher.viewer_hub.newest_event_number,
        )

    @property
    def phase(self) -> Phase:
        if self.is_replay:
            return Phase.REPLAY
        needed = {"acquisition", "estimator"} if self.runs.current else {"acquisition", "estimator", "guard"}
        conditions = {each.condition for name, each in self.supervisor.workers.items() if name in needed}
        if self.tasks.internal_error or WorkerCondition.FAULTED in conditions:
            return Phase.FAULTED
        if conditions != {WorkerCondition.RUNNING} or not self.watchdog.is_sampling:
            return Phase.STARTING
        return Phase.RUNNING if self.runs.current else Phase.IDLE

    def worker_conditions(self) -> dict[str, str]:
        """Return each worker's condition; empty for a service that only shows recordings."""
        if self.is_replay:
            return {}
        return {name: worker.condition.value for name, worker in self.supervisor.workers.items()}

    def render_metrics(self) -> bytes:
        """Return the metrics in the text format of Prometheus."""
        metrics, free_bytes = self.metrics, self.checks.free_disk_bytes
        metrics.phase.state(self.phase.value)
        metrics.set_alarm_counts(self.publisher.alarms.current_alarms())
        metrics.free_disk.set(float("nan") if free_bytes is None else free_bytes)
        metrics.recording.set(self.recorder_link.state.file is not None)
        metrics.viewers.set(len(self.publisher.viewer_hub.viewers))
        metrics.index_dropped_messages.set(self.publisher.index_writer.dropped_messages)
        return metrics.render()

    def _control_holder(self) -> str | None:
        if self.control_lease.holder:
            return self.control_lease.holder
        run = self.runs.current
        if run is None:
            return None
        return "the demonstration" if self.runs.demo_text else run.by or "somebody without a name"
