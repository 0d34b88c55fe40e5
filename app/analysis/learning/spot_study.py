"""The function that builds the page of `graspwatch study spots`: accuracy on spots that were not learned from."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import binomtest

from estimator.decision import NO_ANSWER, NOT_NAMED, UNDECIDED, UNKNOWN
from estimator.learning.cross_validation import FORCE_CHECKPOINTS, TIME_CHECKPOINTS_S, ValidationAnswer
from estimator.learning.spot_validation import RecordingResult
from estimator.studies.probability_scores import calibration_error
from estimator.studies.study_report import KeyFigure, StudyResult, Table

LOG_LOSS_FLOOR = 0.001
MAX_NAMED_STRANGERS = 5.0  # percent of the grasps of a tissue that was left out of the library
EXPLANATION = """
Each recording in turn is left out, and the library is learned anew from the others: centers, scatter, the spread
between spots, and the usual force. So no grasp is judged by a library that knows its spot. A recording counts as one
spot. Intervals are exact binomial ones of 95 %; grasps on one spot are not independent, so the interval of the spots
is the honest one.

Grasps without an answer (a sensor fault) count as wrong in the share of grasps, and are left out of everything else.
Log loss has a floor of 0.001 for the probability of the truth. Times count from the command leaving zero.

"Tissue left out": all recordings of a tissue are left out. Its grasps should be unknown or undecided, never named.
"""


def build_spot_study(
    spots: Sequence[RecordingResult], left_out: Sequence[RecordingResult], settings: dict[str, str]
) -> StudyResult:
    """Build the study's page from the results with each recording, and with each tissue, left out."""
    study = StudyResult("spots", "How right on spots that were not learned", settings, EXPLANATION)
    answers = [answer for result in spots for answer in result.grasps]
    if answers:
        study.figures += _build_grasp_figures(answers)
        study.figures += _build_spot_figures(spots)
    else:
        study.figures.append(KeyFigure("recordings of a tissue that has another one", 0))
    others = [answer for result in left_out for answer in result.grasps if answer.label != NO_ANSWER]
    if others:
        named = sum(each.label not in (*NOT_NAMED, UNKNOWN) for each in others)
        study.figures.append(
            KeyFigure("tissue left out: grasps named", 100 * named / len(others), "%", at_most=MAX_NAMED_STRANGERS)
        )
    study.parts += [_build_file_table(spots), _build_course_table(spots), _build_spot_table(spots)]
    study.parts.append(_build_confusion_table("Confusion of grasps (rows: held; columns: label)", spots))
    if others:
        study.parts.append(_build_confusion_table("Tissue left out: labels of its grasps", left_out))
    return study


def is_right(answer: ValidationAnswer) -> bool:
    """Return whether the likeliest answer is right; a grasp with a sensor fault never is."""
    return answer.label != NO_ANSWER and _top(answer.probabilities) == answer.truth


def _top(probabilities: dict[str, float]) -> str:
    return max(probabilities, key=probabilities.__getitem__)


def _log_loss(answers: Sequence[ValidationAnswer]) -> float | None:
    sound = [each for each in answers if each.label != NO_ANSWER]
    if not sound:
        return None
    return float(np.mean([-np.log(max(each.probabilities[each.truth], LOG_LOSS_FLOOR)) for each in sound]))


def _calibration_error(answers: Sequence[ValidationAnswer]) -> float | None:
    sound = [each for each in answers if each.label != NO_ANSWER]
    if not sound:
        return None
    confidence = np.array([max(each.probabilities.values()) for each in sound])
    return calibration_error(confidence, np.array([is_right(each) for each in sound]))


def _interval(right: int, count: int) -> str:
    """Return the exact binomial interval of 95 %, in percent."""
    found = binomtest(right, count).proportion_ci(0.95, method="exact")
    return f"{100 * found.low:.0f} to {100 * found.high:.0f} %"


def _build_grasp_figures(answers: Sequence[ValidationAnswer]) -> list[KeyFigure]:
    right = sum(map(is_right, answers))
    named = [each for each in answers if each.label not in NOT_NAMED]
    wrong = sum(each.label != each.truth for each in named)
    return [
        KeyFigure("grasps", len(answers)),
        KeyFigure("grasps: likeliest right", 100 * right / len(answers), "%", note=_interval(right, len(answers))),
        KeyFigure("grasps: log loss", _log_loss(answers)),
        KeyFigure("grasps: calibration error", _calibration_error(answers)),
        KeyFigure("grasps: named and right", len(named) - wrong),
        KeyFigure("grasps: named and wrong", wrong),
        KeyFigure("grasps: no answer", sum(each.label == NO_ANSWER for each in answers)),
    ]


def _build_spot_figures(spots: Sequence[RecordingResult]) -> list[KeyFigure]:
    every = [(result.spot[-1], result.truth) for result in spots if result.spot]
    last = [(spot, truth) for spot, truth in every if spot.label != NO_ANSWER]
    figures = [KeyFigure("spots", len(last)), KeyFigure("spots: no answer", len(every) - len(last))]
    if not last:
        return figures
    right = sum(_top(spot.probabilities) == truth for spot, truth in last)
    return [
        *figures,
        KeyFigure("spots: likeliest right", 100 * right / len(last), "%", note=_interval(right, len(last))),
        KeyFigure("spots: named and right", sum(spot.label == truth for spot, truth in last)),
        KeyFigure("spots: named and wrong", sum(spot.label not in (*NOT_NAMED, truth) for spot, truth in last)),
    ]


def _build_file_table(results: Sequence[RecordingResult]) -> Table:
    rows = []
    for result in results:
        right, count = sum(map(is_right, result.grasps)), len(result.grasps)
        named = [each.label for each in result.grasps if each.label not in NOT_NAMED]
        of_truth = named.count(result.truth)
        rows.append(
            [
                result.recording.file,
                result.truth,
                result.others,
                count,
                right,
                _interval(right, count) if count else "",
                _log_loss(result.grasps),
                _calibration_error(result.grasps),
                of_truth,
                len(named) - of_truth,
                sum(each.label == NO_ANSWER for each in result.grasps),
            ]
        )
    columns = ["file", "held", "other spots learned", "grasps", "likeliest right", "95 %", "log loss", "calibration"]
    return Table("By file", [*columns, "named right", "named wrong", "no answer"], rows)


def _build_course_table(results: Sequence[RecordingResult]) -> Table:
    rows = []
    for result in results:
        answers = [each for each in result.grasps if each.label != NO_ANSWER]
        if not answers:
            continue
        count = len(answers)
        at_force = [sum(each.most_likely[i] == each.truth for each in answers) / count for i in range(4)]
        in_time = [
            sum(each.most_likely_in_time[i] == each.truth for each in answers) / count
            for i in range(len(TIME_CHECKPOINTS_S))
        ]
        rows.append([result.recording.file, *(round(share, 2) for share in (*at_force, *in_time))])
    columns = [
        *(f"{100 * share:g} % of the peak" for share in FORCE_CHECKPOINTS[:4]),
        *(f"{1e3 * time:g} ms" for time in TIME_CHECKPOINTS_S),
    ]
    return Table("Share of likeliest answers that are right, while the force rises", ["file", *columns], rows)


def _build_spot_table(results: Sequence[RecordingResult]) -> Table:
    rows = [
        [result.recording.file, result.truth, spot.grasps, spot.label, spot.probabilities.get(result.truth)]
        for result in results
        for spot in result.spot
    ]
    return Table("Spot verdicts", ["file", "held", "after grasps", "label", "probability of what was held"], rows)


def _build_confusion_table(title: str, results: Sequence[RecordingResult]) -> Table:
    answers = [(result.recording.label, answer) for result in results for answer in result.grasps]
    names = sorted({name for _, each in answers for name in each.probabilities} - {UNKNOWN})
    columns = [*names, UNKNOWN, UNDECIDED, NO_ANSWER]
    rows = []
    for held in sorted({held for held, _ in answers}):
        own = [each.label for label, each in answers if label == held]
        rows.append([held, len(own), *(own.count(name) for name in columns)])
    return Table(title, ["held", "grasps", *columns], rows)
