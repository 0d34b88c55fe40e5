"""The estimator worker: a process that turns sample blocks into estimate blocks."""

import json
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import zmq

from acquisition import bus
from acquisition.process import become_worker, take_realtime
from config.schema import Settings, TissueLibrary, Tool
from estimator.alarms import ForceAlarm
from estimator.blocks import EstimateBlock, GraspRecord, Identification, Withdrawal, estimate_dtype

if TYPE_CHECKING:
    from estimator.session import EstimationSession

REALTIME_PRIORITY = 70
POLL_MS = 200


@dataclass(frozen=True, slots=True)
class Setup:
    """All that the worker needs to know."""

    parent_pid: int
    endpoints: bus.Endpoints
    tool: Tool
    library: TissueLibrary
    settings: Settings


def main(setup: Setup) -> None:
    """Run until a signal. Says when its filters are compiled and ready."""
    stop = become_worker("estimator", setup.parent_pid)
    context = zmq.Context()
    samples = bus.subscriber(context, setup.endpoints.samples)
    publisher = bus.publisher(context, setup.endpoints.estimates)
    limits = bus.publisher(context, setup.endpoints.limits)
    publisher.send_multipart(bus.pack_notice("compiling"))
    warm_up(setup)
    granted = take_realtime(setup.settings.realtime, REALTIME_PRIORITY, place=1)
    session = _new_session(setup)
    counter = bus.SequenceCounter()
    last_ready = 0.0
    try:
        while not stop.set:
            if time.monotonic() - last_ready > 1.0:  # repeated: a subscriber may have come late
                granted.priority.renew()
                publisher.send_multipart(bus.pack_notice("estimating", realtime=str(granted)))
                last_ready = time.monotonic()
            if not samples.poll(POLL_MS):
                continue
            parts = samples.recv_multipart()
            if parts[0] != bus.SAMPLES:
                continue
            block = bus.unpack_samples(parts)
            if counter.is_out_of_turn(block):
                continue
            if counter.begins_anew(block.sequence):
                session = _new_session(setup)
            counter.take(block.sequence, block.t_mono_ns)
            estimate = session.process(block)
            limits.send(bus.pack_limit(limit_of(estimate.identification)))  # first: somebody waits for it
            publisher.send_multipart(pack_estimates(estimate, counter.missing))
    finally:
        context.destroy(linger=200)


def warm_up(setup: Setup) -> None:
    """Compile the filters, or load them from the cache, before anything depends on them."""
    from estimator.bank import Contact  # see below

    session = _new_session(setup)
    session.bank.start(Contact(np.array([0.01, 0.0, 7.0, -0.006, 0.0])))
    session.bank.advance(np.array([[0.01, 1e-5, 7.0, -0.006, 0.001]]))
    session.evidence.probabilities()


def _new_session(setup: Setup) -> "EstimationSession":
    from estimator.session import EstimationSession  # with the compiler; the server, which only starts this, needs none

    return EstimationSession(setup.tool, setup.library, setup.settings)


def limit_of(found: Identification) -> bus.ForceLimit:
    """What the acquisition's limiter is told."""
    return bus.ForceLimit(found.threshold_n, found.threshold_tissue, found.tick)


def pack_estimates(block: EstimateBlock, missing_blocks: int) -> list[bytes]:
    header = {
        "sequence": block.sequence,
        "t_mono_ns": block.t_mono_ns,
        "published_ns": time.monotonic_ns(),
        "lost_samples": block.lost_samples,
        "missing_blocks": missing_blocks,
        "identification": bus.fields_of(block.identification),
        "ended": [asdict(grasp) for grasp in block.ended],
        "alarms": [asdict(alarm) for alarm in block.alarms],
        "withdrawn": [asdict(withdrawal) for withdrawal in block.withdrawn],
    }
    return [bus.ESTIMATES, json.dumps(header).encode(), block.estimates.tobytes()]


@dataclass(frozen=True, slots=True)
class ReceivedEstimates:
    """An estimate block on the other side, with when it was published and what the estimator missed so far."""

    block: EstimateBlock
    published_ns: int
    missing_blocks: int


def unpack_estimates(parts: list[bytes], tissues: int) -> ReceivedEstimates:
    header: dict[str, Any] = json.loads(parts[1])
    block = EstimateBlock(
        header["sequence"],
        header["t_mono_ns"],
        header["lost_samples"],
        np.frombuffer(parts[2], estimate_dtype(tissues)),
        Identification(**header["identification"]),
        tuple(GraspRecord(**grasp) for grasp in header["ended"]),
        tuple(ForceAlarm(**alarm) for alarm in header["alarms"]),
        tuple(Withdrawal(**withdrawal) for withdrawal in header["withdrawn"]),
    )
    return ReceivedEstimates(block, header["published_ns"], header["missing_blocks"])
