"""The class BlockReceiver: receives sample blocks and estimates in order, counts them, and passes them on."""

import time
from collections.abc import Callable

from acquisition import bus
from acquisition.sample_block import SampleBlock
from app.service.arming import ArmingController
from app.service.live_stream import LiveStream
from app.service.metrics import Metrics
from app.service.publisher import Publisher
from app.service.sample_monitor import SampleMonitor
from app.service.state_reporter import StateReporter
from app.service.supervisor import Supervisor
from app.service.watchdog import Watchdog
from estimator.estimate_messages import unpack_estimates


class BlockReceiver:
    """Receiver of what acquisition and estimator measure."""

    def __init__(
        self,
        publisher: Publisher,
        supervisor: Supervisor,
        watchdog: Watchdog,
        arming: ArmingController,
        sample_monitor: SampleMonitor,
        live_stream: LiveStream,
        state: StateReporter,
        metrics: Metrics,
    ) -> None:
        self._alarms, self._supervisor, self._watchdog = publisher.alarms, supervisor, watchdog
        self._arming, self._state = arming, state
        self._server_missing, self._estimator_missing = map(metrics.missing_blocks.labels, ("server", "estimator"))
        self._sample_monitor, self._live_stream = sample_monitor, live_stream
        self._sample_sequence, self._estimate_sequence = bus.SequenceTracker(), bus.SequenceTracker()
        self._acquisition_died_ns = 0  # monotonic time at which the last acquisition worker died
        self.listeners: list[Callable[[SampleBlock], None]] = []  # called with every block

    def on_samples(self, parts: list[bytes]) -> None:
        """Receive a sample block."""
        block = bus.unpack_samples(parts)
        is_alive = block.t_mono_ns > self._acquisition_died_ns
        if is_alive and self._supervisor.mark_running("acquisition"):
            self._alarms.end("motor")  # a worker that opens the board first writes zero
            self._state.publish()
        if self._sample_sequence.is_out_of_order(block):
            return
        if self._sample_sequence.is_restart(block.sequence):
            self._live_stream.on_acquisition_restart()
        if is_alive and self._arming.update_from_block(block):
            self._state.publish()
        missing = self._sample_sequence.update(block.sequence, block.t_mono_ns)
        if is_alive:
            self._watchdog.feed("acquisition")
        self._sample_monitor.add_block(block, missing)
        for follow in self.listeners:
            follow(block)
        self._server_missing.set(self._sample_sequence.missing + self._estimate_sequence.missing)
        self._live_stream.add_samples(block)

    def on_estimates(self, parts: list[bytes]) -> None:
        """Receive a block's estimates."""
        received = unpack_estimates(parts, self._live_stream.tissues)
        block = received.block
        self._watchdog.feed("estimator")
        self._estimate_sequence.update(block.sequence)
        self._sample_monitor.add_estimate_latency((received.published_ns - block.t_mono_ns) / 1e9)
        self._estimator_missing.set(received.missing_blocks)
        self._live_stream.add_estimates(block)

    def on_worker_death(self, worker: str) -> None:
        """Forget the grasp under way; blocks of a dead acquisition that still wait do not speak for the next one."""
        self._live_stream.reset_grasp()
        if worker == "acquisition":
            self._acquisition_died_ns = time.monotonic_ns()
