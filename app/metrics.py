"""What an administrator watches, for `GET /metrics`."""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest


class Metrics:
    """One service's metrics in a registry of its own."""

    def __init__(self) -> None:
        registry = self._registry = CollectorRegistry()
        self.samples = Counter("graspwatch_samples", "Samples received from the tool", registry=registry)
        self.lost_samples = Counter("graspwatch_lost_samples", "Samples known to be missing", registry=registry)
        self.missing_blocks = Gauge(
            "graspwatch_missing_blocks", "Blocks lost between the workers", ["receiver"], registry=registry
        )
        self.grasps = Counter("graspwatch_grasps", "Finished grasps", ["label"], registry=registry)
        self.viewers = Gauge("graspwatch_viewers", "Connected viewers", registry=registry)
        self.estimate_latency = Histogram(
            "graspwatch_estimate_latency_seconds",
            "From the last sample of a block to its published estimate",
            buckets=(0.0005, 0.001, 0.002, 0.003, 0.005, 0.01, 0.02, 0.05, 0.1, 1.0),
            registry=registry,
        )
        self.worker_deaths = Counter("graspwatch_worker_deaths", "Workers that died", ["worker"], registry=registry)

    def text(self) -> bytes:
        return generate_latest(self._registry)
