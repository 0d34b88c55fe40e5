"""`graspwatch study mismatch`: truth and sensors that differ from the model: less sure, not wrong."""

from dataclasses import asdict, replace

import numpy as np
import plotly.graph_objects as go

from estimator.studies.course import Bench, Course, follow, same_number_of_each, set_up
from estimator.studies.measures import Score, score
from estimator.studies.report import PALETTE, Figure, Study, Table
from estimator.studies.runner import Progress, run_cases
from estimator.studies.truths import MISMATCHES

MATCHED, UNSENSED = "matched", "contact not sensed"
MOST_POINTS, MOST_CALIBRATION_ERROR = 10.0, 0.10


def mismatch(bench: Bench, grasps: int, seed: int, progress: Progress, jobs: int | None = None) -> Study:
    """Run the study: `grasps` of each tissue with each mismatch, the same specimens every time."""
    library = set_up(bench).library
    names = [*library.tissues]
    kinds = [*MISMATCHES, UNSENSED]
    cases = [
        (replace(bench, touch=bench.touch and kind != UNSENSED), case)
        for kind in kinds
        for case in same_number_of_each(library, grasps, seed, deviation=MISMATCHES.get(kind, MISMATCHES[MATCHED]))
    ]
    answers = run_cases(_answer, cases, progress, jobs)
    truth = np.array([names.index(case.tissue) for _, case in cases[: grasps * len(names)]])
    per_kind = np.array(answers).reshape(len(kinds), len(truth), -1)
    scores = {kind: score(probabilities, truth) for kind, probabilities in zip(kinds, per_kind, strict=True)}
    study = Study(
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
        Figure("share right, matched", 100 * matched, "%"),
        Figure("furthest behind the matched case", behind[worst], "points", at_most=MOST_POINTS, note=worst),
        Figure(
            "largest expected calibration error",
            scores[dishonest].calibration_error,
            at_most=MOST_CALIBRATION_ERROR,
            note=dishonest,
        ),
        *(
            Figure(f"behind the matched case: {kind}", points, "points", at_most=MOST_POINTS)
            for kind, points in behind.items()
        ),
        *(
            Figure(
                f"expected calibration error: {kind}", scores[kind].calibration_error, at_most=MOST_CALIBRATION_ERROR
            )
            for kind in behind
        ),
    ]
    columns = ["truth", "share right", "calibration error", "confident and wrong", "confident", "log loss"]
    rows = [[kind, *_row(found)] for kind, found in scores.items()]
    study.parts = [
        Table("Share right and honesty, mismatch by mismatch", columns, rows),
        ("Share right, and expected calibration error", _bars(scores)),
    ]
    return study


def _answer(job) -> np.ndarray:
    bench, case = job
    course: Course = follow(bench, case)
    return course.probabilities[-1]


def _row(found: Score) -> list[float]:
    return [found.accuracy, found.calibration_error, found.confident_wrong, found.confident, found.log_loss]


def _bars(scores: dict[str, Score]) -> go.Figure:
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
