"""The studies that there are: what each is called, how large it is, and how it is carried out."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from estimator.studies.runner import Progress

if TYPE_CHECKING:  # they take a second: not before a study is carried out
    from estimator.studies.course import Bench
    from estimator.studies.report import Study

MOST_GRASPS, MOST_SEEDS = 100_000, 1_000


@dataclass(frozen=True, slots=True)
class StudyEntry:
    """A study. `carry_out(bench, grasps, seed, progress, jobs)` does it; without `jobs` on all cores.

    `usual` and `most` are grasps of each tissue (and of each condition); where there is no bench, seeds.
    """

    name: str
    title: str
    usual: int
    most: int
    carry_out: Callable[["Bench", int, int, Progress, int | None], "Study"]
    on_bench: bool = True
    """Whether it simulates grasps as a `Bench` says; else the bench means nothing to it."""
    weighs_thickness: bool = True
    """Whether thickness at contact can be evidence in it."""
    plays_protocol: bool = True
    """Whether the bench's protocol is what it plays; else it makes its own."""


def _paper(bench: "Bench", seeds: int, seed: int, progress: Progress, jobs: int | None) -> "Study":
    from estimator.studies.paper import paper

    return paper(seeds, seed, progress, jobs)


def _identify(bench: "Bench", grasps: int, seed: int, progress: Progress, jobs: int | None) -> "Study":
    from estimator.studies.identify import identify

    return identify(bench, grasps, seed, progress, jobs)


def _unknown(bench: "Bench", grasps: int, seed: int, progress: Progress, jobs: int | None) -> "Study":
    from estimator.studies.unknown import unknown

    return unknown(bench, grasps, seed, progress, jobs)


def _initial(bench: "Bench", grasps: int, seed: int, progress: Progress, jobs: int | None) -> "Study":
    from estimator.studies.initial import initial

    return initial(bench, grasps, seed, progress, jobs)


def _mismatch(bench: "Bench", grasps: int, seed: int, progress: Progress, jobs: int | None) -> "Study":
    from estimator.studies.mismatch import mismatch

    return mismatch(bench, grasps, seed, progress, jobs)


def _estimators(bench: "Bench", grasps: int, seed: int, progress: Progress, jobs: int | None) -> "Study":
    from estimator.studies.estimators import estimators

    # the other filters know nothing of thickness
    return estimators(replace(bench, thickness=False), grasps, seed, progress, jobs)


def _limiter(bench: "Bench", grasps: int, seed: int, progress: Progress, jobs: int | None) -> "Study":
    from estimator.studies.limiter import limiter

    return limiter(bench, grasps, seed, progress, jobs)


_ALL = (
    StudyEntry(
        "paper",
        "Tables III, IV and V and Figures 4 and 5 of the paper, beside its own scheme and ours.",
        10,
        MOST_SEEDS,
        _paper,
        on_bench=False,
        weighs_thickness=False,
    ),
    StudyEntry(
        "identify",
        "Share right against time beside the Bayes limit, confusion, calibration, decisions, errors of parameters.",
        250,
        MOST_GRASPS,
        _identify,
    ),
    StudyEntry(
        "unknown",
        "Tissues and things outside the library: called unknown? And the library's own: wrongly so?",
        100,
        MOST_GRASPS,
        _unknown,
    ),
    StudyEntry(
        "initial",
        "Guesses of alpha and beta off by 0.1 to 10 times: share converged within 0.3 s, beside the paper's filter.",
        2,
        MOST_GRASPS,
        _initial,
        weighs_thickness=False,
    ),
    StudyEntry(
        "mismatch",
        "Truth that differs from the model: damping, relaxation, late touch, scales, motion, mass, friction.",
        100,
        MOST_GRASPS,
        _mismatch,
    ),
    StudyEntry(
        "estimators",
        "Ours, the paper's filter, an unscented and a particle filter on the same grasps.",
        60,
        MOST_GRASPS,
        _estimators,
        weighs_thickness=False,
    ),
    StudyEntry(
        "limiter",
        "Commands up to 5 N, identified right, wrongly, late or not at all: force over the limit? Still held?",
        500,
        MOST_GRASPS,
        _limiter,
        weighs_thickness=False,
        plays_protocol=False,
    ),
)
STUDIES = {entry.name: entry for entry in _ALL}
