"""`graspwatch study mismatch`: the answers' accuracy and calibration if tissue or sensors differ from the model."""

from dataclasses import asdict, replace

import numpy as np
import plotly.graph_objects as go

from estimator.studies.answer_course import (
    ProbabilityHistory,
    StudyConditions,
    build_balanced_cases,
    estimate_grasp,
    load_study_setup,
)
from estimator.studies.case_runner import Progress, run_cases
from estimator.studies.out_of_library import MISMATCHES
from estimator.studies.probability_scores import Score, score_answers
from estimator.studies.simulated_grasps import GraspCase
from estimator.studies.study_report import PALETTE, KeyFigure, StudyResult, Table

MATCHED, CONTACT_NOT_SENSED = "matched", "contact not sensed"
MAX_POINTS_BEHIND, MAX_CALIBRATION_ERROR = 10.0, 0.10


def run_mismatch_study(
    bench: StudyConditions, grasps: int, seed: int, progress: Progress, jobs: int | None = None
) -> StudyResult:
    """Run the study with `grasps` of each tissue with each mismatch, on the same specimens every time."""
    library = load_study_setup(bench).library
    names = [*library.tissues]
    kinds = [*MISMATCHES, CONTACT_NOT_SENSED]
    cases = [
        (replace(bench, touch=bench.touch and kind != CONTACT_NOT_SENSED), case)
        for kind in kinds
        for case in build_balanced_cases(library, grasps, seed, deviation=MISMATCHES.get(kind, MISMATCHES[MATCHED]))
    ]
    answers = run_cases(_evaluate_case, cases, progress, jobs)
    truth = np.array([names.index(case.tissue) for _, case in cases[: grasps * len(names)]])
    per_kind = np.array(answers).reshape(len(kinds), len(truth), -1)
    scores = {kind: score_answers(probabilities, truth) for kind, probabilities in zip(kinds, per_kind, strict=True)}
    study = StudyResult(
        "mismatch",
        "When the model is wrong",
        {**asdict(bench), "grasps of each tissue and mismatch": grasps, "seed": seed},
        "The same specimens in every row; answers at the grasp's end. Two filters a tissue compete: a strict one, "
        "which takes Eq. (7) at its word, and a lenient one, whose tissue may leave its curve. Where the equation "
        "does not hold, the lenient one explains the data better, and the answer becomes less sure instead of "
        "wrong.",
    )
    matched = scores[MATCHED].accuracy
    behind = {kind: 100 * (matched - found.accuracy) for kind, found in scores.items() if kind != MATCHED}
    worst = max(behind, key=behind.__getitem__)
    dishonest = max(behind, key=lambda kind: scores[kind].calibration_error)
    study.figures = [
        KeyFigure("share right, matched", 100 * matched, "%"),
        KeyFigure("furthest behind the matched case", behind[worst], "points", at_most=MAX_POINTS_BEHIND, note=worst),
        KeyFigure(
            "largest expected calibration error",
            scores[dishonest].calibration_error,
            at_most=MAX_CALIBRATION_ERROR,
            note=dishonest,
        ),
        *(
            KeyFigure(f"behind the matched case: {kind}", points, "points", at_most=MAX_POINTS_BEHIND)
            for kind, points in behind.items()
        ),
        *(
            KeyFigure(
                f"expected calibration error: {kind}", scores[kind].calibration_error, at_most=MAX_CALIBRATION_ERROR
            )
            for kind in behind
        ),
    ]
    columns = ["truth", "share right", "calibration error", "confident and wrong", "confident", "log loss"]
    rows = [[kind, *_row(found)] for kind, found in scores.items()]
    study.parts = [
        Table("Share right and honesty, mismatch by mismatch", columns, rows),
        ("Share right, and expected calibration error", _plot_scores(scores)),
    ]
    return study


def _evaluate_case(job: tuple[StudyConditions, GraspCase]) -> np.ndarray:
    bench, case = job
    course: ProbabilityHistory = estimate_grasp(bench, case)
    return course.probabilities[-1]


def _row(found: Score) -> list[float]:
    return [found.accuracy, found.calibration_error, found.confident_wrong, found.confident, found.log_loss]


def _plot_scores(scores: dict[str, Score]) -> go.Figure:
    figure = go.Figure()
    kinds = [*scores]
    figure.add_bar(
        y=kinds, x=[s.accuracy for s in scores.values()], orientation="h", name="share right", marker_color=PALETTE[0]
    )
    figure.add_bar(
        y=kinds,
        x=[s.calibration_error for s in scores.values()],
        orientation="h",
        name="expected calibration error",
        marker_color=PALETTE[1],
    )
    figure.update_layout(barmode="group", yaxis={"autorange": "reversed"}, height=700)
    return figure
