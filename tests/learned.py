"""Learn libraries from simulated or real recordings, for the tests of learning."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from app.analysis.learning.training_set import load_training_set
from config.schema import Settings, TissueLibrary, Tool
from estimator.learning.library_fit import fit_library
from estimator.learning.recorded_grasps import LabeledRecording, estimate_usual_peak_v, extract_loading_curves


def gathered(
    files: dict[str, list[Path]], tool: Tool, base: TissueLibrary, settings: Settings
) -> list[LabeledRecording]:
    """Load the labeled recordings of these files."""
    return load_training_set(files, tool, base, settings, 2, lambda _: None).recordings


def learner(tool: Tool, base: TissueLibrary) -> Callable[[Sequence[LabeledRecording]], TissueLibrary]:
    """Return a function that learns a library from recordings."""

    def learn(recordings: Sequence[LabeledRecording]) -> TissueLibrary:
        peak_v = estimate_usual_peak_v(list(recordings))
        curves = [extract_loading_curves(each, tool, peak_v) for each in recordings]
        return fit_library(curves, tool, base, "porcine", peak_v, name="learned", date="2026-01-01")

    return learn


def pressed(
    stiffness: float,
    *,
    gap_deg: float = 120.0,
    stretch: float = 52.189,
    seed: int = 0,
    noise_v: float = 1e-3,
    rest_v: float = 0.82,
    offset_deg: float = 0.0,
) -> np.ndarray:
    """Construct a grasp, dtype SAMPLE: the jaws travel steadily and shut after `gap_deg`.

    The tissue resists exponentially with the travel; `stiffness` is its strain voltage 10 deg before jaw closure, V.
    """
    from acquisition.sample_block import SAMPLE_DTYPE

    travel = np.concatenate([np.linspace(0, gap_deg, 300), np.full(200, gap_deg)])
    tissue_v = stiffness * np.exp(-(gap_deg - travel) / 15.0 + 10 / 15)
    shut = np.concatenate([np.zeros(300), np.linspace(0, 1, 100), np.ones(100)])
    volt = (1 - shut) * tissue_v + shut * 2.5 + np.random.default_rng(seed).normal(0, noise_v, 500)
    samples = np.zeros(500, SAMPLE_DTYPE)
    samples["tick"] = np.arange(500)
    samples["strain_v"] = rest_v + volt
    samples["encoder_deg"] = offset_deg + travel + stretch * volt
    samples["motor_command_v"] = np.minimum(np.arange(1, 501) * 0.01, 2.0)
    samples["grasp"] = 1
    return samples
