"""The class LiveStream, which sends viewers frames of samples with their estimates, and messages about grasps."""

import math

from pydantic import BaseModel

from acquisition.sample_block import SampleBlock
from app.host.clock import monotonic_to_wall_ms, now_ms
from app.host.logs import LogContext
from app.messages.grasps import Grasp, GraspEnded, Identification
from app.service.annotations import Annotations
from app.service.metrics import Metrics
from app.service.publisher import Publisher
from app.service.runs import RunRegistry
from app.stream.event_translator import EventTranslator
from app.stream.frames import FrameBuffer
from app.stream.sample_aligner import SampleAligner
from config.service_plan import ServicePlan
from estimator.estimate_block import EstimateBlock


class LiveStream:
    """Stream of frames and of identifications and grasps, to all viewers."""

    def __init__(
        self,
        plan: ServicePlan,
        publisher: Publisher,
        runs: RunRegistry,
        annotations: Annotations,
        metrics: Metrics,
        log_context: LogContext,
    ) -> None:
        self._library, self._sample_rate_hz = plan.library, plan.tool.board.sample_rate_hz
        self.tissues = len(plan.library.tissues)
        self._dose_threshold_n_s = plan.tool.to_displayed_n(plan.settings.warnings.spot_dose_n_s)
        self._publisher, self._runs, self._metrics, self._log_context = publisher, runs, metrics, log_context
        self._annotations = annotations
        self._frame_buffer = FrameBuffer(int(plan.settings.server.history_s * self._sample_rate_hz))
        self._aligner = SampleAligner(self._frame_buffer, self.tissues)
        self._translator = self._make_translator()
        self._nis: dict[str, float | None] = dict.fromkeys(plan.library.tissues)
        self._fit_metrics = {tissue: metrics.filter_nis.labels(tissue) for tissue in plan.library.tissues}
        self._set_fit_metrics()

    @property
    def identification(self) -> Identification | None:
        """The identification of the grasp under way."""
        return self._translator.identification

    def add_samples(self, block: SampleBlock) -> None:
        self._aligner.add_samples(block)

    def add_estimates(self, block: EstimateBlock) -> None:
        self._aligner.add_estimates(block)
        self._nis = block.identification.nis
        self._translator.process(block, now_ms(), monotonic_to_wall_ms(block.t_mono_ns))

    def _set_fit_metrics(self) -> None:
        """Set the metric of each filter's fit; NaN without an estimate."""
        for tissue, value in self._nis.items():
            self._fit_metrics[tissue].set(math.nan if value is None else value)

    def send_frames(self) -> None:
        """Send the samples since the last call to the viewers."""
        self._set_fit_metrics()
        self._aligner.align()
        for frame in self._frame_buffer.cut_frames():
            self._publisher.viewer_hub.broadcast_frame(frame)

    def history_frames(self) -> list[bytes]:
        """Return frames with the last seconds of samples."""
        return self._frame_buffer.history_frames()

    def on_acquisition_restart(self) -> None:
        """Begin anew after a restart of the acquisition, whose block numbers and ticks begin anew."""
        self._aligner.reset()
        self._runs.reset_ticks()
        self._annotations.on_acquisition_restart()
        self.reset_grasp()

    def reset_grasp(self) -> None:
        """Forget the grasp under way after a worker died or restarted: no message about its end will come."""
        self._log_context.grasp = None
        self._publisher.alarms.end_force_alarm()
        self._translator = self._make_translator()

    def _make_translator(self) -> EventTranslator:
        alarms = self._publisher.alarms
        return EventTranslator(
            self._library, self._sample_rate_hz, self._dose_threshold_n_s, alarms, self._publish, self._on_grasp_ended
        )

    def _publish(self, message: BaseModel) -> None:
        if isinstance(message, Identification):
            self._log_context.grasp = message.grasp if message.in_grasp else None
        self._publisher.publish(message)

    def _on_grasp_ended(self, grasp: Grasp) -> None:
        self._metrics.grasps.labels(grasp.label).inc()
        self._metrics.dose.inc(grasp.dose_n_s or 0.0)
        run_id, grasp = self._runs.add_grasp(grasp, round(grasp.start_s * self._sample_rate_hz))
        self._publisher.publish(GraspEnded(run_id=run_id, grasp=grasp))
        self._annotations.on_grasp_end(run_id, grasp)
