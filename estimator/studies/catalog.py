"""The catalog of studies: name, default and largest number of grasps, and the Python function that runs it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from estimator.studies.case_runner import Progress

if TYPE_CHECKING:  # these imports take a second, so they wait until a study runs
    from estimator.studies.answer_course import StudyConditions
    from estimator.studies.study_report import StudyResult

MAX_GRASPS, MAX_SEEDS = 100_000, 1_000


@dataclass(frozen=True, slots=True)
class StudyDefinition:
    """A study. `run(conditions, count, seed, progress, jobs)` runs it; `jobs` None means all cores.

    `default_count` and `max_count` are grasps of each tissue (and of each condition), or seeds if the study does not
    use conditions.
    """

    name: str
    title: str
    default_count: int
    max_count: int
    run: Callable[["StudyConditions", int, int, Progress, int | None], "StudyResult"]
    uses_conditions: bool = True
    """Whether it simulates grasps under `StudyConditions`; if not, it ignores them."""
    uses_thickness: bool = True
    """Whether thickness at contact can be evidence in it."""
    uses_protocol: bool = True
    """Whether it plays the conditions' protocol; if not, it creates its own."""


def _run_paper(bench: "StudyConditions", seeds: int, seed: int, progress: Progress, jobs: int | None) -> "StudyResult":
    from estimator.studies.paper import run_paper_study

    return run_paper_study(seeds, seed, progress, jobs)


def _run_identify(
    bench: "StudyConditions", grasps: int, seed: int, progress: Progress, jobs: int | None
) -> "StudyResult":
    from estimator.studies.identify import run_identify_study

    return run_identify_study(bench, grasps, seed, progress, jobs)


def _run_repeated(
    bench: "StudyConditions", spots: int, seed: int, progress: Progress, jobs: int | None
) -> "StudyResult":
    from estimator.studies.spot_verdicts import run_spot_verdict_study

    return run_spot_verdict_study(bench, spots, seed, progress, jobs)


def _run_unknown(
    bench: "StudyConditions", grasps: int, seed: int, progress: Progress, jobs: int | None
) -> "StudyResult":
    from estimator.studies.unknown import run_unknown_study

    return run_unknown_study(bench, grasps, seed, progress, jobs)


def _run_initial(
    bench: "StudyConditions", grasps: int, seed: int, progress: Progress, jobs: int | None
) -> "StudyResult":
    from estimator.studies.initial import run_initial_study

    return run_initial_study(bench, grasps, seed, progress, jobs)


def _run_mismatch(
    bench: "StudyConditions", grasps: int, seed: int, progress: Progress, jobs: int | None
) -> "StudyResult":
    from estimator.studies.mismatch import run_mismatch_study

    return run_mismatch_study(bench, grasps, seed, progress, jobs)


def _run_estimators(
    bench: "StudyConditions", grasps: int, seed: int, progress: Progress, jobs: int | None
) -> "StudyResult":
    from estimator.studies.estimators import run_estimators_study

    # the other filters do not use thickness
    return run_estimators_study(replace(bench, thickness=False), grasps, seed, progress, jobs)


def _run_limiter(
    bench: "StudyConditions", grasps: int, seed: int, progress: Progress, jobs: int | None
) -> "StudyResult":
    from estimator.studies.limiter import run_limiter_study

    return run_limiter_study(bench, grasps, seed, progress, jobs)


_DEFINITIONS = (
    StudyDefinition(
        "paper",
        "Tables III, IV and V and Figures 4 and 5 of the paper, beside its own scheme and ours.",
        10,
        MAX_SEEDS,
        _run_paper,
        uses_conditions=False,
        uses_thickness=False,
    ),
    StudyDefinition(
        "identify",
        "Share right against time beside the Bayes limit, confusion, calibration, decisions, errors of parameters.",
        250,
        MAX_GRASPS,
        _run_identify,
    ),
    StudyDefinition(
        "repeated",
        "Three grasps on one spot: the verdict of the spot, beside what the samples allow.",
        100,
        MAX_GRASPS,
        _run_repeated,
    ),
    StudyDefinition(
        "unknown",
        "Tissues and things outside the library: called unknown? And the library's own: wrongly so?",
        100,
        MAX_GRASPS,
        _run_unknown,
    ),
    StudyDefinition(
        "initial",
        "Guesses of alpha and beta off by 0.1 to 10 times: share converged within 0.3 s, beside the paper's filter.",
        2,
        MAX_GRASPS,
        _run_initial,
        uses_thickness=False,
    ),
    StudyDefinition(
        "mismatch",
        "Truth that differs from the model: damping, relaxation, late touch, scales, motion, mass, friction.",
        100,
        MAX_GRASPS,
        _run_mismatch,
    ),
    StudyDefinition(
        "estimators",
        "Ours, the paper's filter, an unscented and a particle filter on the same grasps.",
        60,
        MAX_GRASPS,
        _run_estimators,
        uses_thickness=False,
    ),
    StudyDefinition(
        "limiter",
        "Commands up to 5 N, identified right, wrongly, late or not at all: force over the limit? Still held?",
        500,
        MAX_GRASPS,
        _run_limiter,
        uses_thickness=False,
        uses_protocol=False,
    ),
)
STUDIES = {entry.name: entry for entry in _DEFINITIONS}
