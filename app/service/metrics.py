"""The class Metrics: the Prometheus metrics of a service (`GET /metrics`)."""

from collections.abc import Iterable

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Enum,
    Gauge,
    Histogram,
    Info,
    PlatformCollector,
    ProcessCollector,
    generate_latest,
)

from app import __version__
from app.messages.alarms import Alarm, AlarmKind
from app.messages.live import Phase
from estimator.force_alarms import Priority

LATENESS_BUCKETS_S = tuple(
    ms / 1e3 for ms in (0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0, 1000.0)
)
SERVER_DELAY_BUCKETS_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 2.0)


class Metrics:
    """The metrics of one service, in a registry of their own."""

    def __init__(self, workers: Iterable[str], labels: Iterable[str]) -> None:
        """Make all series, each at 0: an alert rule does not see a series rise that begins with its first event."""
        registry = self._registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        PlatformCollector(registry=registry)
        Info("graspwatch_build", "What runs here", registry=registry).info({"version": __version__})
        self.phase = Enum(
            "graspwatch_phase", "Where the tool stands", states=[each.value for each in Phase], registry=registry
        )
        self.alarms = Gauge(
            "graspwatch_alarms", "Alarms that are on, by kind and priority", ["kind", "priority"], registry=registry
        )
        self.free_disk = Gauge(
            "graspwatch_free_disk_bytes", "Room for what is kept; NaN: the data folder is gone", registry=registry
        )
        self.recording = Gauge("graspwatch_recording", "1 while a run is being recorded", registry=registry)
        self.samples = Counter("graspwatch_samples", "Samples received from the tool", registry=registry)
        self.lost_samples = Counter("graspwatch_lost_samples", "Samples known to be missing", registry=registry)
        self.missing_blocks = Gauge(
            "graspwatch_missing_blocks", "Blocks lost between the workers, by receiver", ["receiver"], registry=registry
        )
        self.grasps = Counter("graspwatch_grasps", "Finished grasps, by label", ["label"], registry=registry)
        self.dose = Counter(
            "graspwatch_dose_newton_seconds",
            "Displayed force over the time in contact, of finished grasps",
            registry=registry,
        )
        self.filter_nis = Gauge(
            "graspwatch_filter_nis",
            "Normalized innovation squared of each tissue's filter, 1 where it follows the grasp; NaN: no estimate",
            ["tissue"],
            registry=registry,
        )
        self.index_dropped_messages = Gauge(
            "graspwatch_index_left_out", "Messages that the index lacks until it is rebuilt", registry=registry
        )
        self.viewers = Gauge("graspwatch_viewers", "Connected viewers", registry=registry)
        self.estimate_latency = Histogram(
            "graspwatch_estimate_latency_seconds",
            "From the last sample of a block to its published estimate",
            buckets=LATENESS_BUCKETS_S,
            registry=registry,
        )
        self.acquisition_lateness = Histogram(
            "graspwatch_acquisition_lateness_seconds",
            "How much later than the promptest a block was read, by the sample clock",
            buckets=LATENESS_BUCKETS_S,
            registry=registry,
        )
        self.late_blocks = Counter(
            "graspwatch_late_blocks", "Blocks read more than 0.1 s after their last sample", registry=registry
        )
        self.server_delay = Histogram(
            "graspwatch_server_delay_seconds",
            "How late the event loop, which carries STOP, came to send a sign of life",
            buckets=SERVER_DELAY_BUCKETS_S,
            registry=registry,
        )
        self.worker_deaths = Counter(
            "graspwatch_worker_deaths", "Workers that died, by worker", ["worker"], registry=registry
        )
        for worker in workers:
            self.worker_deaths.labels(worker)
        for label in labels:
            self.grasps.labels(label)
        for receiver in ("server", "estimator"):
            self.missing_blocks.labels(receiver)
        self.set_alarm_counts([])

    def set_alarm_counts(self, alarms: list[Alarm]) -> None:
        """Set the number of alarms of each kind and priority, zeros included."""
        for kind in AlarmKind:
            for priority in Priority:
                count = sum(each.kind is kind and each.priority is priority for each in alarms)
                self.alarms.labels(kind.value, priority.value).set(count)

    def render(self) -> bytes:
        return generate_latest(self._registry)
