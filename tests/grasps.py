"""Simulated grasps through the real driver and the real conditioning, for the estimator's tests."""

import numpy as np

from acquisition.control import Acquisition
from acquisition.simulation.grasper import Specimen
from acquisition.tools import open_tool


def conditioned(tool, library, settings, protocol, tissue, seed=1, cycles=1) -> tuple[np.ndarray, Specimen]:
    """All samples of a run, and the last specimen held."""
    source, grasper = open_tool(tool, library, tissue, seed, virtual=True)
    blocks = []
    with source:
        acquisition = Acquisition(source, tool, settings.conditioning)
        acquisition.start("test", protocol, cycles)
        while not acquisition.take_ended():
            blocks.append(acquisition.turn().samples)
    return np.concatenate(blocks), grasper.specimen


def signals(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What the bank takes: force, displacement, and how strain noise enters both."""
    held = samples[samples["contact_tick"] >= 0]
    names = ("jaw_force_n", "tissue_displacement_m", "newton_per_volt", "metre_per_volt")
    return tuple(np.ascontiguousarray(held[name]) for name in names)
