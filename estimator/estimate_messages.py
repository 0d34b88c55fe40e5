"""Functions that pack estimates for the bus (estimator), and unpack them (server, recorder and Foxglove worker).

A message is the topic, a JSON header, and the rows of `estimate_dtype` as bytes.
"""

import time
from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel

from acquisition import bus
from estimator.estimate_block import EstimateBlock, GraspRecord, IdentificationResult, LabelWithdrawal, estimate_dtype
from estimator.force_alarms import ForceAlarm


class _Publication(BaseModel):
    sequence: int
    published_ns: int


class _Header(_Publication):
    t_mono_ns: int
    lost_samples: int
    missing_blocks: int
    identification: IdentificationResult
    ended: tuple[GraspRecord, ...]
    alarms: tuple[ForceAlarm, ...]
    withdrawn: tuple[LabelWithdrawal, ...]


@dataclass(frozen=True, slots=True)
class ReceivedEstimates:
    """An estimate block as received, with its time of publication and the number of blocks the estimator missed."""

    block: EstimateBlock
    published_ns: int
    missing_blocks: int


@dataclass(frozen=True, slots=True)
class PublishedEstimates:
    """The rows of one block, and its time of publication."""

    sequence: int
    published_ns: int
    estimates: np.ndarray


def pack_estimates(block: EstimateBlock, missing_blocks: int) -> list[bytes]:
    header = _Header(
        sequence=block.sequence,
        published_ns=time.monotonic_ns(),
        t_mono_ns=block.t_mono_ns,
        lost_samples=block.lost_samples,
        missing_blocks=missing_blocks,
        identification=block.identification,
        ended=block.ended,
        alarms=block.alarms,
        withdrawn=block.withdrawn,
    )
    return [bus.ESTIMATES_TOPIC, header.model_dump_json().encode(), block.estimates.tobytes()]


def unpack_estimates(parts: list[bytes], tissues: int) -> ReceivedEstimates:
    header = _Header.model_validate_json(parts[1])
    block = EstimateBlock(
        header.sequence,
        header.t_mono_ns,
        header.lost_samples,
        np.frombuffer(parts[2], estimate_dtype(tissues)),
        header.identification,
        header.ended,
        header.alarms,
        header.withdrawn,
    )
    return ReceivedEstimates(block, header.published_ns, header.missing_blocks)


def unpack_estimate_rows(parts: list[bytes], tissues: int) -> PublishedEstimates:
    """Unpack the rows alone, in a fraction of the time."""
    published = _Publication.model_validate_json(parts[1])
    rows = np.frombuffer(parts[2], estimate_dtype(tissues))
    return PublishedEstimates(published.sequence, published.published_ns, rows)
