"""Functions that simulate grasps for the studies, with specimen, sensors, calibration and conditioning as in a run."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from acquisition.protocol_player import ProtocolPlayer
from acquisition.sample_block import SampleBlock
from acquisition.signals.pipeline import ConditioningPipeline
from acquisition.simulation.grasper import SimulatedGrasper, collect_block
from acquisition.simulation.tissue import NO_DEVIATION, ModelDeviation, Specimen
from config.schema import ConditioningSettings, GraspProtocol, TissueLibrary, Tool
from estimator.constants import JAW_OPENING_SHARE, MIN_PEAK_BEFORE_OPENING_N

FORCE_CONTACT_RISE_V = 0.02  # as in the shipped tools without trusted touch sensors
FORCE_MEAN_SAMPLES = 5


@dataclass(frozen=True, slots=True)
class GraspCase:
    """One grasp to simulate."""

    tissue: str
    seed: int
    deviation: ModelDeviation = NO_DEVIATION
    tissue_library: TissueLibrary | None = None  # library of `tissue`, if not the study's


@dataclass(frozen=True, slots=True)
class SimulatedGrasp:
    """A simulated grasp: conditioned samples of dtype SAMPLE, and the specimen held."""

    samples: np.ndarray
    specimen: Specimen


def simulate_grasp(
    tool: Tool, library: TissueLibrary, conditioning: ConditioningSettings, protocol: GraspProtocol, case: GraspCase
) -> SimulatedGrasp:
    """Play one cycle of `protocol` on the simulated grasper; return its conditioned samples and the specimen."""
    return simulate_spot(tool, library, conditioning, protocol, case, grasps=1)[-1]


def simulate_spot(
    tool: Tool,
    library: TissueLibrary,
    conditioning: ConditioningSettings,
    protocol: GraspProtocol,
    case: GraspCase,
    grasps: int,
) -> list[SimulatedGrasp]:
    """Play `grasps` cycles of `protocol` on one spot; return each grasp with the samples from the grasp before on."""
    block = tool.board.block_samples
    player = ProtocolPlayer(protocol, tool, grasps)
    commands: list[float] = []
    while not player.done:
        commands += [player.next_command(block)] * block
    grasper = SimulatedGrasper(tool, case.tissue_library or library, case.tissue, case.seed, case.deviation)
    readings, specimens = [], []
    for command in commands:
        readings.append(grasper.step(command))
        if not specimens or grasper.specimen is not specimens[-1]:
            specimens.append(grasper.specimen)
    samples = ConditioningPipeline(tool, conditioning).process(collect_block(readings, commands, first_tick=0)).samples
    ends = np.searchsorted(samples["grasp"], np.arange(2, grasps + 1))
    return [
        SimulatedGrasp(part, specimen)
        for part, specimen in zip(np.split(samples, ends), specimens[-grasps:], strict=True)
    ]


def split_into_blocks(samples: np.ndarray, tool: Tool) -> Iterator[SampleBlock]:
    """Yield conditioned samples in blocks of the tool's size, as the acquisition publishes them."""
    size = tool.board.block_samples
    for begin in range(0, len(samples), size):
        yield SampleBlock(begin, 0, 0, samples[begin : begin + size])


def extract_contact_samples(grasp: SimulatedGrasp) -> np.ndarray:
    """Return the samples from first contact until the jaws open, as the estimator learns from them."""
    samples = grasp.samples
    held = np.flatnonzero(samples["contact_tick"] >= 0)
    begin = int(np.searchsorted(samples["tick"], samples["contact_tick"][held[0]]))
    samples = samples[begin : int(held[-1]) + 1]
    felt_n = np.convolve(samples["jaw_force_n"], np.full(FORCE_MEAN_SAMPLES, 1 / FORCE_MEAN_SAMPLES), "valid")
    peak_n = np.maximum.accumulate(felt_n)
    released = np.flatnonzero((peak_n > MIN_PEAK_BEFORE_OPENING_N) & (felt_n < JAW_OPENING_SHARE * peak_n))
    return samples[: int(released[0])] if len(released) else samples


def with_noise(tool: Tool, strain_sd_v: float) -> Tool:
    """Return the tool with another strain noise, which the estimator knows."""
    return tool.model_copy(update={"noise": tool.noise.model_copy(update={"strain_sd_v": strain_sd_v})})


def without_touch(tool: Tool) -> Tool:
    """Return the tool without touch sensors: contact comes from force and motion alone, as on the rig of 2013."""
    blind = {"touch_trusted": False, "force_rise_v": FORCE_CONTACT_RISE_V}
    return tool.model_copy(update={"contact": tool.contact.model_copy(update=blind)})
