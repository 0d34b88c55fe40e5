"""The class WorkerMonitor, which handles the workers' notices and deaths: alarms, ended runs, what may start next."""

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
    WaitingForSamples,
)
from app.messages.alarms import AlarmKind
from app.messages.runs import RunState
from app.service.arming import ArmingController
from app.service.block_receiver import BlockReceiver
from app.service.metrics import Metrics
from app.service.publisher import Publisher
from app.service.recorder_link import RecorderLink
from app.service.run_controller import RunController
from app.service.state_reporter import StateReporter
from app.service.supervisor import Supervisor
from app.service.watchdog import Watchdog
from estimator.force_alarms import Priority


class WorkerMonitor:
    """Monitor of the workers' notices and deaths."""

    def __init__(
        self,
        publisher: Publisher,
        supervisor: Supervisor,
        watchdog: Watchdog,
        arming: ArmingController,
        recorder_link: RecorderLink,
        receiver: BlockReceiver,
        run_controller: RunController,
        state: StateReporter,
        metrics: Metrics,
    ) -> None:
        self._publisher, self._alarms, self._supervisor = publisher, publisher.alarms, supervisor
        self._watchdog, self._arming, self._recorder_link = watchdog, arming, recorder_link
        self._receiver = receiver
        self._run_controller, self._state, self._metrics = run_controller, state, metrics
        self._fault_texts: dict[str, str] = {}  # by worker: what it said before it died
        self.realtime: dict[str, str] = {}  # scheduling that the system granted each process

    def on_acquisition(self, parts: list[bytes]) -> None:
        """Handle a notice or a sample block of the acquisition."""
        if parts[0] == bus.NOTICE_TOPIC:
            self._on_notice(bus.unpack_notice(parts))
        else:
            self._receiver.on_samples(parts)

    def on_estimator(self, parts: list[bytes]) -> None:
        """Handle a notice or a block of estimates of the estimator."""
        if parts[0] == bus.NOTICE_TOPIC:
            self._on_notice(bus.unpack_notice(parts))
        else:
            self._receiver.on_estimates(parts)

    def _on_notice(self, notice: Notice) -> None:
        match notice:
            case CompilingFilters():
                self._publisher.publish_event(
                    "Preparing the filters (compiled on the first start, which takes up to a minute)"
                )
            case Estimating():
                self._fault_texts.pop("estimator", None)
                self.realtime["estimator"] = notice.realtime
                if self._supervisor.mark_running("estimator"):
                    self._watchdog.on_estimator_started()
                self._supervisor.open_tool()
            case Acquiring():
                self._fault_texts.pop("acquisition", None)
                self.realtime["acquisition"] = notice.realtime
                self._publisher.publish_event(f"The tool is acquiring; {notice.realtime}")
            case AcquisitionFailed():
                self._fault_texts["acquisition"] = notice.text
                self._alarms.raise_technical("acquisition", Priority.HIGH, notice.text)
            case AcquisitionStalled():
                self._publisher.publish_event(notice.text)
            case WaitingForSamples():
                self._watchdog.on_waiting_for_samples(notice.why)
                if not self._supervisor.mark_running("acquisition"):
                    return  # it comes many times a second
            case GraspReleased():
                self._alarms.raise_latched("let-go", AlarmKind.FORCE, notice.text)
            case RunEnded():
                self._run_controller.end(notice.run_id, RunState(notice.end), notice.why)
        self._state.publish()

    def on_recorder(self, parts: list[bytes]) -> None:
        """Handle a notice of the recorder."""
        self._watchdog.feed("recorder")
        self._supervisor.mark_running("recorder")
        before = self._recorder_link.state.file
        notice = bus.unpack_notice(parts)
        if isinstance(notice, RecorderStatus):
            self.realtime["recorder"] = notice.realtime
        self._recorder_link.on_notice(notice)
        if self._recorder_link.state.file != before:
            self._state.publish()

    def on_safety_monitor(self, parts: list[bytes]) -> None:
        """Handle a notice of the safety monitor."""
        self._watchdog.feed("guard")
        self._supervisor.mark_running("guard")
        notice = bus.unpack_notice(parts)
        match notice:
            case Monitoring():
                self.realtime["guard"] = notice.realtime
            case MotorZeroed():
                self.on_motor_fault(None)
                self._alarms.raise_technical("samples", Priority.HIGH, notice.text)
            case MotorNotZeroed():
                self.on_motor_fault(notice.text)

    def on_foxglove(self, parts: list[bytes]) -> None:
        """Handle a sign of life of the Foxglove worker."""
        if self._supervisor.mark_running("foxglove"):
            self._alarms.end("foxglove")
            self._state.publish()

    def on_motor_fault(self, fault: str | None) -> None:
        """Raise an alarm if the motor of a dead or silent worker cannot be brought to zero; None ends the alarm."""
        self._alarms.update_technical("motor", Priority.HIGH, fault)

    def on_replacement(self, worker: str) -> None:
        """Handle the end of a worker that is replaced on purpose."""
        self._watchdog.forget(worker)
        if worker != "recorder":
            self._receiver.on_worker_death(worker)
        if worker == "acquisition":
            self._arming.on_worker_replacement()
        self._state.publish()

    def on_death(self, worker: str, text: str) -> None:
        """Handle the death of a worker: alarm, end of the run; `text` is the supervisor's account of it."""
        self._metrics.worker_deaths.labels(worker).inc()
        if worker == "recorder":
            self._recorder_link.on_worker_death(text)
            self._state.publish()
            return
        if worker == "foxglove":
            self._alarms.raise_technical(worker, Priority.LOW, text)
            return
        if worker == "guard":
            self._alarms.raise_technical(worker, Priority.HIGH, f"{text} A hung acquisition would be noticed late")
            return
        self._receiver.on_worker_death(worker)
        text = " ".join(filter(None, (self._fault_texts.pop(worker, None), text)))
        self._alarms.raise_technical(worker, Priority.HIGH, text)
        self._publisher.publish_event(text)
        if worker == "acquisition":
            why = "the acquisition worker died"
            self._arming.on_worker_death(why)
            self._run_controller.fail_current(why)
        self._state.publish()
