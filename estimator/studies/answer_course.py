"""Conditions and cases of studies, and the function that records the live estimator's answer over time."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from acquisition.simulation.tissue import NO_DEVIATION, ModelDeviation
from config.load import load_grasp_protocol, load_library, load_settings, load_tool
from config.schema import GraspProtocol, Settings, TissueLibrary, Tool
from estimator.decision import NOT_NAMED
from estimator.estimate_block import GraspRecord
from estimator.online_estimator import TissueEstimator
from estimator.studies.simulated_grasps import (
    GraspCase,
    SimulatedGrasp,
    simulate_grasp,
    split_into_blocks,
    with_noise,
    without_touch,
)

STEP_S = 0.005


@dataclass(frozen=True, slots=True)
class StudyConditions:
    """Conditions of all grasps of a study. It holds names of files, so that it goes to other processes cheaply."""

    protocol: str = "trapezoid_2hz"
    library: str = "porcine"
    noise_mv: float = 2.0
    spread: float = 1.0
    touch: bool = True
    thickness: bool = True


@dataclass(frozen=True, slots=True)
class StudySetup:
    """The files that `StudyConditions` name, loaded."""

    tool: Tool
    library: TissueLibrary
    settings: Settings
    protocol: GraspProtocol


@lru_cache(maxsize=8)
def load_study_setup(bench: StudyConditions) -> StudySetup:
    """Load the conditions' files, with their noise and specimens' spread on the simulated tool."""
    tool = with_noise(load_tool("simulated"), bench.noise_mv * 1e-3)
    assert tool.simulation is not None
    tool = tool.model_copy(update={"simulation": tool.simulation.model_copy(update={"spread_scale": bench.spread})})
    settings = load_settings()
    identification = settings.identification.model_copy(update={"use_thickness": bench.thickness})
    return StudySetup(
        tool if bench.touch else without_touch(tool),
        load_library(bench.library),
        settings.model_copy(update={"identification": identification}),
        load_grasp_protocol(bench.protocol),
    )


@dataclass(frozen=True, slots=True)
class ProbabilityHistory:
    """The estimator's answer for one grasp over time: row i of `probabilities` was known `times_s[i]` after contact."""

    case: GraspCase
    times_s: np.ndarray  # (steps,)
    probabilities: np.ndarray  # (steps, M + 1)
    record: GraspRecord
    labels: tuple[str, ...]  # labels within the grasp, in their order
    thickness_m: float
    log_parameters: np.ndarray  # (3,) the specimen's own
    grasp: SimulatedGrasp | None = None

    def probabilities_at(self, time_s: float) -> np.ndarray:
        """Return the probabilities, (M + 1,), at a time after contact; the first ones before contact was known."""
        known = int(np.searchsorted(self.times_s, time_s + 1e-9, side="right")) - 1
        return self.probabilities[max(known, 0)]


def estimate_grasp(bench: StudyConditions, case: GraspCase) -> ProbabilityHistory:
    """Simulate a grasp and run the live estimator on it; return its answer over time."""
    lab = load_study_setup(bench)
    grasp = simulate_grasp(lab.tool, lab.library, lab.settings.conditioning, lab.protocol, case)
    session = TissueEstimator(lab.tool, lab.library, lab.settings)
    rows, ticks, labels, record = [], [], [], None
    for samples in split_into_blocks(grasp.samples, lab.tool):
        block = session.process(samples)
        found = block.identification
        if found.in_grasp and found.in_contact:
            rows.append(np.fromiter(found.probabilities.values(), float))
            ticks.append(found.tick)
        if found.label not in (*NOT_NAMED, *labels[-1:]):
            labels.append(found.label)
        record = block.ended[0] if block.ended else record
    record = record or session.finish()
    assert record is not None, "a protocol commands a grasp"
    return ProbabilityHistory(
        case,
        np.array(ticks) / lab.tool.board.sample_rate_hz - (record.contact_s or 0.0) if rows else np.zeros(1),
        np.array(rows) if rows else np.fromiter(record.probabilities.values(), float)[None],
        record,
        tuple(labels),
        grasp.specimen.thickness_m,
        grasp.specimen.log_parameters,
        grasp,
    )


def build_balanced_cases(
    library: TissueLibrary, grasps: int, seed: int, deviation: ModelDeviation = NO_DEVIATION
) -> list[GraspCase]:
    """Return `grasps` cases of every tissue of the library, each with its own seed."""
    return [
        GraspCase(tissue, seed * 1_000_000 + number * 10_000 + grasp, deviation)
        for number, tissue in enumerate(library.tissues)
        for grasp in range(grasps)
    ]
