"""The function that builds a learned library's report: confusion, reliability, time to decision, recordings."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from config.schema import TissueLibrary
from estimator.decision import NO_ANSWER, NOT_NAMED, UNDECIDED, UNKNOWN
from estimator.learning.cross_validation import FORCE_CHECKPOINTS, ValidationAnswer
from estimator.loading.constants import FEATURES
from estimator.studies.probability_scores import compute_reliability, score_answers
from estimator.studies.study_report import PALETTE, KeyFigure, StudyResult, Table
from estimator.studies.tissue_colors import UNKNOWN_COLOR

EXPLANATION = """
What this library says of grasps that it was not learned from. "another recording": each recording in turn is left out,
and the library learned anew from the others. "another tissue": all recordings of a tissue are left out, so that its
grasps should be unknown. "later grasps" and "earlier grasps": one half in time of every recording is learned from, and
the other asked; that knows the session, and is too kind.

A name is given from a probability of 0.95 on; "likeliest" asks for the largest probability alone. A recording that is
left out may be the only one of its tissue at that ramp: then a low score says that the ramp matters, not that the
library with that recording in it is as bad.
"""


def build_report(
    name: str, library: TissueLibrary, answers: Sequence[ValidationAnswer], settings: dict[str, str]
) -> StudyResult:
    """Build the report from the answers of a cross-validation."""
    study = StudyResult(name, f"Learned library: {name.replace('_', ' ')}", settings, EXPLANATION)
    questions = list(dict.fromkeys(answer.question for answer in answers))
    for question in questions:
        _add_figures(study, question, [each for each in answers if each.question == question])
    study.parts.append(_build_training_table(library))
    study.parts.append(_build_excluded_grasps_table(library))
    for question in questions:
        study.parts.append(_build_confusion_table(question, [each for each in answers if each.question == question]))
    study.parts.append(_build_recordings_table(answers))
    if answers:
        study.parts.append(("Reliability", _plot_reliability(answers, questions)))
        study.parts.append(("Share right while the force rises", _plot_accuracy_over_force(answers, questions)))
    study.parts.append(_build_feature_centers_table(library))
    return study


def _add_figures(study: StudyResult, question: str, answers: list[ValidationAnswer]) -> None:
    names = sorted({name for each in answers for name in each.probabilities})
    table = np.array([[each.probabilities.get(name, 0.0) for name in names] for each in answers])
    truth = np.array([names.index(each.truth) if each.truth in names else names.index(UNKNOWN) for each in answers])
    found = score_answers(table, truth)
    named = [each for each in answers if each.label not in NOT_NAMED]
    wrong = sum(each.label != each.truth for each in named)
    decided = [each.decided_s for each in named if each.decided_s is not None]
    study.figures += [
        KeyFigure(f"{question}: grasps", len(answers)),
        KeyFigure(f"{question}: right by the likeliest", 100 * found.accuracy, "%"),
        KeyFigure(f"{question}: right by name", 100 * (len(named) - wrong) / len(answers), "%"),
        KeyFigure(f"{question}: wrong by name", 100 * wrong / len(answers), "%"),
        KeyFigure(f"{question}: expected calibration error", found.calibration_error),
        KeyFigure(f"{question}: log loss", found.log_loss),
        KeyFigure(
            f"{question}: decided, median since the command", float(np.median(decided)) if decided else None, "s"
        ),
    ]


def _build_training_table(library: TissueLibrary) -> Table:
    rows = [
        [name, each.file, each.grasps, len(each.left_out), each.ramp_v_per_s, each.sha256[:12]]
        for name, profile in library.tissues.items()
        for each in (profile.learned.recordings if profile.learned else ())
    ]
    return Table("Learned from", ["tissue", "file", "grasps", "left out", "ramp, V/s", "SHA-256"], rows)


def _build_excluded_grasps_table(library: TissueLibrary) -> Table:
    rows = [
        [name, each.file, *text.partition(": ")[::2]]
        for name, profile in library.tissues.items()
        for each in (profile.learned.recordings if profile.learned else ())
        for text in each.left_out
    ]
    return Table("Grasps left out", ["tissue", "file", "grasp", "why"], rows)


def _build_confusion_table(question: str, answers: list[ValidationAnswer]) -> Table:
    names = sorted({each.truth for each in answers} | {name for each in answers for name in each.probabilities})
    names = [*(name for name in names if name != UNKNOWN), UNKNOWN, UNDECIDED, NO_ANSWER]
    rows = []
    for truth in sorted({each.truth for each in answers}):
        own = [each.label for each in answers if each.truth == truth]
        rows.append([truth, len(own), *(round(own.count(name) / len(own), 3) for name in names)])
    return Table(f"Confusion by name: {question}", ["truth", "grasps", *names], rows)


def _build_recordings_table(answers: Sequence[ValidationAnswer]) -> Table:
    rows = []
    for question, recording in sorted({(each.question, each.recording) for each in answers}):
        own = [each for each in answers if (each.question, each.recording) == (question, recording)]
        course = [
            sum(each.most_likely[i] == each.truth for each in own) / len(own) for i in range(len(FORCE_CHECKPOINTS) + 1)
        ]
        named = sum(each.label == each.truth for each in own) / len(own)
        rows.append([question, recording, len(own), named, *(round(share, 3) for share in course)])
    at = [f"likeliest at {100 * share:g} %" for share in FORCE_CHECKPOINTS]
    return Table("By recording", ["question", "recording", "grasps", "by name", *at, "likeliest at the end"], rows)


def _build_feature_centers_table(library: TissueLibrary) -> Table:
    rows = [
        [name, each.file, *each.centre]
        for name, profile in library.tissues.items()
        for each in (profile.learned.recordings if profile.learned else ())
    ]
    return Table("Centres of the loading curves' features", ["tissue", "file", *FEATURES], rows)


def _plot_reliability(answers: Sequence[ValidationAnswer], questions: list[str]) -> go.Figure:
    figure = go.Figure()
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", line={"color": UNKNOWN_COLOR, "dash": "dot"}, name="honest")
    for question, colour in zip(questions, PALETTE, strict=False):
        own = [
            max(each.probabilities.items(), key=lambda item: (item[1], item[0]))
            for each in answers
            if each.question == question
        ]
        truth = [each.truth for each in answers if each.question == question]
        confidence = np.array([probability for _, probability in own])
        right = np.array([name == right for (name, _), right in zip(own, truth, strict=True)])
        mean, share, number = compute_reliability(confidence, right)
        filled = number > 0
        figure.add_scatter(x=mean[filled], y=share[filled], mode="lines+markers", line={"color": colour}, name=question)
    figure.update_xaxes(title="probability of the likeliest answer", range=[0, 1])
    figure.update_yaxes(title="share right", range=[0, 1])
    return figure


def _plot_accuracy_over_force(answers: Sequence[ValidationAnswer], questions: list[str]) -> go.Figure:
    figure = go.Figure()
    for question, colour in zip(questions, PALETTE, strict=False):
        own = [each for each in answers if each.question == question]
        shares = [
            np.mean([each.most_likely[i] == each.truth for each in own]) for i in range(len(FORCE_CHECKPOINTS) + 1)
        ]
        figure.add_scatter(
            x=[*FORCE_CHECKPOINTS, 1.0], y=shares, mode="lines+markers", line={"color": colour}, name=question
        )
    figure.update_xaxes(title="force, share of the usual peak (1: the end of the grasp)")
    figure.update_yaxes(title="share right by the likeliest", range=[0, 1])
    return figure
