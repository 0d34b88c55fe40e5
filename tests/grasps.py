"""Simulate grasps through the real driver and the real conditioning, for the estimator's tests."""

from itertools import pairwise

import numpy as np

from acquisition.acquisition_loop import AcquisitionController
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SampleBlock
from acquisition.simulation.tissue import Specimen
from acquisition.tool_factory import open_tool
from estimator.estimate_block import EstimateBlock, GraspRecord
from estimator.filter_bank import ContactStart, bank_columns, build_contact_start
from estimator.online_estimator import TissueEstimator


def conditioned(tool, library, settings, protocol, tissue, seed=1, cycles=1) -> tuple[np.ndarray, Specimen]:
    """Return all samples of a run, and the last specimen held."""
    source, grasper = open_tool(tool, library, tissue, seed, virtual=True)
    blocks = []
    with source:
        acquisition = AcquisitionController(source, tool, settings.conditioning, safety=Safety.ARMED)
        acquisition.start("test", protocol, cycles)
        while not acquisition.pop_ended_runs():
            blocks.append(acquisition.process_block().samples)
    return np.concatenate(blocks), grasper.specimen


def signals(samples: np.ndarray, *, sensed: bool = True) -> tuple[ContactStart, np.ndarray]:
    """Return the filter bank's input of one grasp: its contact, and the samples after it, (n, 5)."""
    held = samples[samples["contact_tick"] >= 0]
    approach_m_per_s = 0.0 if sensed else 0.03
    contact = build_contact_start(held[0], approach_m_per_s, contact_sensed=sensed)
    return contact, bank_columns(held[1:], held["jaw_displacement_m"][0], int(held["tick"][0]), 1e-3)


def by(samples: np.ndarray, size: int) -> list[int]:
    """Return the indices that cut samples into blocks of a size."""
    return list(range(size, len(samples), size))


def processed(
    session: TissueEstimator, samples: np.ndarray, cuts: list[int]
) -> tuple[list[EstimateBlock], list[GraspRecord]]:
    """Process samples, cut into blocks; return the estimate blocks and the records of all grasps."""
    blocks, last_tick = [], int(samples["tick"][0]) - 1
    for sequence, (begin, end) in enumerate(pairwise([0, *cuts, len(samples)])):
        part = samples[begin:end]
        lost = int(part["tick"][0]) - last_tick - 1
        blocks.append(session.process(SampleBlock(sequence, 0, lost, part)))
        last_tick = int(part["tick"][-1])
    records = [record for block in blocks for record in block.ended]
    last = session.finish()
    return blocks, records + ([last] if last else [])
