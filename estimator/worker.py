"""The estimator worker: the process that turns sample blocks into estimate blocks."""

import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Self

import numpy as np

from acquisition import bus
from acquisition.notices import CompilingFilters, Estimating, RunMetadata
from acquisition.worker_life import begin_worker
from acquisition.worker_process import apply_realtime
from config.schema import UNKNOWN_CONDITIONS, ReferenceGrasp, Settings, SourceConditions, TissueLibrary, Tool
from estimator.estimate_block import IdentificationResult
from estimator.estimate_messages import pack_estimates

if TYPE_CHECKING:
    from estimator.online_estimator import TissueEstimator

REALTIME_PRIORITY = 70
POLL_INTERVAL_MS = 200


@dataclass(frozen=True, slots=True)
class EstimatorSetup:
    """Start parameters of the estimator worker."""

    parent_pid: int
    endpoints: bus.Endpoints
    tool: Tool
    library: TissueLibrary
    settings: Settings

    def with_tool(self, tool: Tool) -> Self:
        return replace(self, tool=tool)


def main(setup: EstimatorSetup) -> None:
    """Run the estimator until a signal stops it. Publish a notice when the filters are compiled."""
    with begin_worker("estimator", setup.parent_pid, setup.endpoints.estimates) as life:
        samples = bus.open_subscriber(life.context, setup.endpoints.samples, setup.endpoints.events)
        limits = bus.open_publisher(life.context, setup.endpoints.thresholds)
        life.publisher.send_multipart(bus.pack_notice(CompilingFilters()))
        compile_filters(setup)
        granted = apply_realtime(setup.settings.realtime, REALTIME_PRIORITY, core_index=1)
        session = _create_estimator(setup)
        counter, conditions = bus.SequenceTracker(), UNKNOWN_CONDITIONS
        last_ready = 0.0
        while not life.stop.is_set:
            if time.monotonic() - last_ready > 1.0:  # repeated, because a subscriber may connect late
                granted.priority.renew()
                life.publisher.send_multipart(bus.pack_notice(Estimating(str(granted))))
                last_ready = time.monotonic()
            if not samples.poll(POLL_INTERVAL_MS):
                continue
            parts = samples.recv_multipart()
            if parts[0] == bus.NOTICE_TOPIC and isinstance(announced := bus.unpack_notice(parts), RunMetadata):
                conditions = conditions_of(announced)
                session.use_conditions(conditions)
            if parts[0] != bus.SAMPLES_TOPIC:
                continue
            block = bus.unpack_samples(parts)
            if counter.is_out_of_order(block):
                continue
            if counter.is_restart(block.sequence):
                session = _create_estimator(setup)
                session.use_conditions(conditions)
            counter.update(block.sequence, block.t_mono_ns)
            estimate = session.process(block)
            # The threshold goes first: the limiter waits for it.
            limits.send(bus.pack_threshold(to_threshold_update(estimate.identification)))
            life.publisher.send_multipart(pack_estimates(estimate, counter.missing))


def conditions_of(run: RunMetadata) -> SourceConditions:
    """Return the conditions of a run that begins now."""
    reference = ReferenceGrasp.model_validate_json(run.reference) if run.reference else None
    return SourceConditions(datetime.now(UTC), reference)


def compile_filters(setup: EstimatorSetup) -> None:
    """Compile the filters, or load them from the cache, before the first sample arrives."""
    from estimator.filter_bank import ContactStart  # imported here for the reason below

    session = _create_estimator(setup)
    session.bank.start(ContactStart(np.array([0.01, 0.0, 7.0, -0.006, 0.0])))
    session.bank.advance(np.array([[0.01, 1e-5, 7.0, -0.006, 0.001]]))
    session.evidence.probabilities()


def _create_estimator(setup: EstimatorSetup) -> "TissueEstimator":
    # Imported here, because it loads the compiler, which the server that starts this worker does not need.
    from estimator.online_estimator import TissueEstimator

    return TissueEstimator(setup.tool, setup.library, setup.settings)


def to_threshold_update(found: IdentificationResult) -> bus.ThresholdUpdate:
    """Return the threshold message for the acquisition's limiter."""
    return bus.ThresholdUpdate(found.threshold_n, found.threshold_tissue, found.tick)
