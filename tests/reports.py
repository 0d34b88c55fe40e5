"""Grasps and analyzed recordings for the report's tests."""

from functools import lru_cache
from typing import Any

from simulation import simulate_raw

from acquisition.signals.pipeline import ConditioningPipeline
from app.analysis.report.recording_analyzer import AnalyzedRecording, RecordingAnalyzer
from app.analysis.report.statistics import Observation, TruthSource
from config.load import load_library, load_settings, load_tool
from estimator.estimate_block import GraspRecord


def record(**changes: Any) -> GraspRecord:
    """Return a valid grasp of liver; `convergence_s` and `force_error_n` apply to all of its filters."""
    each = {name: changes.pop(name, value) for name, value in (("convergence_s", 0.1), ("force_error_n", 0.0))}
    told = {
        "index": 1,
        "start_s": 0.5,
        "contact_s": 0.52,
        "end_s": 1.2,
        "label": "liver",
        "probability": 0.97,
        "probabilities": {"liver": 0.97, "bladder": 0.02, "unknown": 0.01},
        "time_to_decision_s": 0.1,
        "alpha_n": 0.85,
        "beta_per_m": 1900.0,
        "damping_kg_per_s": 3.0,
        "peak_force_n": 1.5,
        "peak_displacement_m": 6e-4,
        "valid": True,
        "why_invalid": None,
        "held_back": False,
    }
    filters = {name: dict.fromkeys(("liver", "bladder"), value) for name, value in each.items()}
    return GraspRecord(**told | filters | changes)


def observed(
    grasp: GraspRecord,
    *,
    truth: str | None = None,
    told: TruthSource = TruthSource.VERDICT,
    source: str = "a.lvm",
    errors: tuple[float, float] | None = (-0.1, 0.1),
) -> Observation:
    return Observation(source, grasp, truth, told, dict.fromkeys(("liver", "bladder"), errors))


@lru_cache
def simulated_story(tissue: str, cycles: int = 3, protocol: str = "trapezoid_2hz", seed: int = 1) -> AnalyzedRecording:
    """Simulate a run and return it as an analyzed recording."""
    tool, settings = load_tool("simulated"), load_settings()
    blocks, pipeline = simulate_raw(tissue, protocol, seed, cycles), ConditioningPipeline(tool, settings.conditioning)
    samples = sum(len(block) for block in blocks)
    teller = RecordingAnalyzer(tissue, tool, load_library("porcine"), settings, samples)
    for block in blocks:
        teller.process(pipeline.process(block))
    return teller.finish(tissue=tissue)
