"""The class SampleMonitor: rate, losses, lateness and latency of the samples, and the limit in force."""

import time
from collections import deque

from acquisition.sample_block import SampleBlock
from app.host.clock import monotonic_to_wall_ms
from app.service.metrics import Metrics
from app.stream.alarms import AlarmManager
from config.schema import Tool
from estimator.estimate_block import finite_or_none
from estimator.force_alarms import Priority

LOSS_ALARM_DURATION_S = 5.0
LATE_SAMPLES_S = 0.1  # samples read later than this count as late
CLOCK_DRIFT = 1e-4  # greatest difference of the clocks of board and computer
MAX_RATE_BLOCKS = 400  # over which the sample rate is measured: two seconds of a run


class SampleMonitor:
    """Monitor of the samples, which raises alarms about lost and late ones."""

    def __init__(self, tool: Tool, alarms: AlarmManager, metrics: Metrics) -> None:
        self._sample_rate_hz = tool.board.sample_rate_hz
        self._alarms, self._metrics = alarms, metrics
        self._recent_counts: deque[tuple[float, int]] = deque(maxlen=MAX_RATE_BLOCKS)
        self._min_delay_s = float("inf")
        self._last_loss_s = self._last_late_s = 0.0
        self.lost_samples = 0
        self.last_tick = -1
        self._last_read_ns = 0  # when the last block was read, by the monotonic clock
        self.limit_n: float | None = None
        self.estimate_latency_ms: float | None = None

    @property
    def rate_hz(self) -> float:
        """Rate of the samples received lately; 0 if none came for a second."""
        counts = self._recent_counts
        if len(counts) < 2 or time.monotonic() - counts[-1][0] > 1.0:
            return 0.0
        return sum(n for _, n in list(counts)[1:]) / (counts[-1][0] - counts[0][0])

    def add_block(self, block: SampleBlock, missing_blocks: int) -> None:
        """Add a block, before which `missing_blocks` did not arrive."""
        self.last_tick, self._last_read_ns = int(block.samples["tick"][-1]), block.t_mono_ns
        self.limit_n = finite_or_none(float(block.samples["limit_n"][-1]))
        self._recent_counts.append((time.monotonic(), len(block.samples)))
        self._observe_lateness(block)
        self._check_lateness(block)
        self._metrics.samples.inc(len(block.samples))
        self._count_lost_samples(block.lost_samples + missing_blocks * len(block.samples))

    def compute_time_ms(self, tick: int) -> float:
        """Return the time of a recent sample, ms since 1970 by the service's clock."""
        return monotonic_to_wall_ms(self._last_read_ns) - (self.last_tick - tick) / self._sample_rate_hz * 1e3

    def add_estimate_latency(self, latency_s: float) -> None:
        """Add the time from the last sample of a block to its published estimates."""
        self.estimate_latency_ms = latency_s * 1e3
        self._metrics.estimate_latency.observe(latency_s)

    def end_old_alarms(self) -> None:
        """End the alarms about samples that were lost or late some seconds ago."""
        if time.monotonic() - self._last_loss_s > LOSS_ALARM_DURATION_S:
            self._alarms.end("lost")
        if time.monotonic() - self._last_late_s > LOSS_ALARM_DURATION_S:
            self._alarms.end("late")

    def _observe_lateness(self, block: SampleBlock) -> None:
        """Measure how much later a block was read than the promptest so far, relative to the sample clock."""
        clock_s = (int(block.samples["tick"][-1]) + 1) / self._sample_rate_hz
        behind_s = block.t_mono_ns / 1e9 - clock_s
        if block.sequence == 1:
            self._min_delay_s = behind_s
        self._min_delay_s = min(self._min_delay_s + CLOCK_DRIFT * len(block.samples) / self._sample_rate_hz, behind_s)
        self._metrics.acquisition_lateness.observe(behind_s - self._min_delay_s)

    def _check_lateness(self, block: SampleBlock) -> None:
        """Count a block that was read late; in a run, where the limiter then acts late too, raise an alarm."""
        if block.backlog <= LATE_SAMPLES_S * self._sample_rate_hz:
            return
        self._metrics.late_blocks.inc()
        if not block.run:
            return
        self._last_late_s = time.monotonic()
        text = f"Samples are read more than {LATE_SAMPLES_S:g} s late, and the limiter acts as late: end other programs"
        self._alarms.raise_technical("late", Priority.MEDIUM, text)

    def _count_lost_samples(self, samples: int) -> None:
        if samples:
            self.lost_samples += samples
            self._last_loss_s = time.monotonic()
            self._metrics.lost_samples.inc(samples)
            self._alarms.raise_technical("lost", Priority.LOW, "Samples are being lost: the status strip counts them")
