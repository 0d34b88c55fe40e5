"""`graspwatch study mismatch`: the answers' accuracy and calibration if tissue or sensors differ from the model."""

from dataclasses import asdict, replace

import numpy as np
import plotly.graph_objects as go

from estimator.studies.answer_course import StudyConditions, build_balanced_cases, estimate_grasp, load_study_setup
from estimator.studies.case_runner import Progress, run_cases
from estimator.studies.knowledge_limit import KnowledgeLimit, build_limit_figures, compute_case_limit
from estimator.studies.out_of_library import HUNT_CROSSLEY, MISMATCHES
from estimator.studies.probability_scores import Score, score_answers
from estimator.studies.simulated_grasps import GraspCase
from estimator.studies.study_report import PALETTE, KeyFigure, StudyResult, Table

MATCHED, CONTACT_NOT_SENSED = "matched", "contact not sensed"
LIMIT_TIMES_S = (1.0,)
MAX_POINTS_BEHIND, MAX_CALIBRATION_ERROR = 10.0, 0.10


def run_mismatch_study(
    bench: StudyConditions, grasps: int, seed: int, progress: Progress, jobs: int | None = None
) -> StudyResult:
    """Run the study with `grasps` of each tissue with each mismatch, on the same specimens every time."""
    library = load_study_setup(bench).library
    names = [*library.tissues]
    kinds = [*MISMATCHES, CONTACT_NOT_SENSED]
    cases = [
        (replace(bench, touch=bench.touch and kind != CONTACT_NOT_SENSED), case, kind == MATCHED)
        for kind in kinds
        for case in build_balanced_cases(library, grasps, seed, deviation=MISMATCHES.get(kind, MISMATCHES[MATCHED]))
    ]
    outcomes = run_cases(_evaluate_case, cases, progress, jobs)
    limits = [limit for _, limit in outcomes if limit]
    truth = np.array([names.index(case.tissue) for _, case, _ in cases[: grasps * len(names)]])
    per_kind = np.array([probabilities for probabilities, _ in outcomes]).reshape(len(kinds), len(truth), -1)
    scores = {kind: score_answers(probabilities, truth) for kind, probabilities in zip(kinds, per_kind, strict=True)}
    wrong = {
        kind: _compute_wrong_share(probabilities, truth) for kind, probabilities in zip(kinds, per_kind, strict=True)
    }
    study = StudyResult(
        "mismatch",
        "When the model is wrong",
        {**asdict(bench), "grasps of each tissue and mismatch": grasps, "seed": seed},
        "The same specimens in every row; answers at the grasp's end. Two filters a tissue compete: a strict one, "
        "which takes Eq. (7) at its word, and a lenient one, whose tissue may leave its curve. Where the equation "
        "does not hold, the lenient one explains the data better, and the answer becomes less sure instead of "
        "wrong. Damping that grows in proportion to displacement, to seven times the tissue's own, is another tissue "
        "than the library's: there unknown is an answer, and only a wrong tissue counts against it.",
    )
    matched = scores[MATCHED].accuracy
    behind = {
        kind: 100 * (matched - found.accuracy)
        for kind, found in scores.items()
        if kind not in (MATCHED, HUNT_CROSSLEY)  # there unknown is an answer
    }
    worst = max(behind, key=behind.__getitem__)
    dishonest = max(behind, key=lambda kind: scores[kind].calibration_error)
    study.figures = [
        *build_limit_figures(limits, LIMIT_TIMES_S, LIMIT_TIMES_S),
        KeyFigure("share right, matched", 100 * matched, "%"),
        KeyFigure("furthest behind the matched case", behind[worst], "points", at_most=MAX_POINTS_BEHIND, note=worst),
        KeyFigure(
            "another tissue likeliest, more often than in the matched case",
            100 * (wrong[HUNT_CROSSLEY] - wrong[MATCHED]),
            "points",
            at_most=MAX_POINTS_BEHIND,
            note=HUNT_CROSSLEY,
        ),
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
    columns = [
        "truth",
        "share right",
        "another tissue likeliest",
        "calibration error",
        "confident and wrong",
        "confident",
        "log loss",
    ]
    rows = [[kind, found.accuracy, wrong[kind], *_row(found)] for kind, found in scores.items()]
    study.parts = [
        Table("Share right and honesty, mismatch by mismatch", columns, rows),
        ("Share right, and expected calibration error", _plot_scores(scores)),
    ]
    return study


def _evaluate_case(job: tuple[StudyConditions, GraspCase, bool]) -> tuple[np.ndarray, KnowledgeLimit | None]:
    """Return the answer at the grasp's end, (M + 1,), and the grasp's limit where it is asked for."""
    bench, case, with_limit = job
    course = estimate_grasp(bench, case)
    return course.probabilities[-1], compute_case_limit(
        bench, case, LIMIT_TIMES_S, course.grasp
    ) if with_limit else None


def _compute_wrong_share(probabilities: np.ndarray, truth: np.ndarray) -> float:
    """Return the share of answers, (n, M + 1), whose likeliest is another tissue than the truth, not unknown."""
    likeliest = probabilities.argmax(axis=1)
    return float(((likeliest != truth) & (likeliest != probabilities.shape[1] - 1)).mean())


def _row(found: Score) -> list[float]:
    return [found.calibration_error, found.confident_wrong, found.confident, found.log_loss]


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
