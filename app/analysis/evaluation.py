"""The function behind `graspwatch evaluate`: how right and how honest answers are, by what was held."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from config.errors import ConfigurationError
from estimator.decision import NO_ANSWER, NOT_NAMED, UNDECIDED, UNKNOWN
from estimator.studies.html_page import Table
from estimator.studies.probability_scores import CONFIDENCE_THRESHOLD, compute_reliability, score_answers
from estimator.studies.study_report import PALETTE, KeyFigure, StudyResult
from estimator.studies.tissue_colors import UNKNOWN_COLOR

PROBABILITY_PREFIX = "probabilities_"
LOG_LOSS_FLOOR = 0.001  # least probability of the truth, as in the study of spots
MAX_REVIEWED = 30
EXPLANATION = (
    "Grasps whose truth a person stated, or a run of the simulated grasper. Grasps that were empty, slipped or held "
    "two tissues are left out, and so are invalid ones. A truth that the library does not know counts as `unknown`. "
    "Log loss has a floor of 0.001 for the probability of the truth. Times count from contact."
)

BREAKDOWNS = ("truth", "recording", "spot", "session", "subject", "tool")
"""Columns by which figures are broken down; each gets a table if it has several values."""

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class JudgedGrasp:
    """A grasp with its truth. `probabilities` of the library's tissues and `unknown`."""

    recording: str
    index: int
    truth: str
    label: str
    probabilities: dict[str, float]
    decided_s: float | None
    categories: dict[str, str]
    """The grasp's value of each column of BREAKDOWNS."""

    @property
    def right_answer(self) -> str:
        """The truth, or `unknown` if the library does not know it."""
        return self.truth if self.truth in self.probabilities else UNKNOWN

    @property
    def of_truth(self) -> float:
        return self.probabilities.get(self.right_answer, 0.0)

    @property
    def likeliest(self) -> str:
        return max(self.probabilities, key=lambda name: (self.probabilities[name], name))

    @property
    def is_named(self) -> bool:
        """Whether the answer is a tissue of the library."""
        return self.label not in (*NOT_NAMED, UNKNOWN)

    @property
    def is_confident_and_wrong(self) -> bool:
        is_wrong = self.likeliest not in (self.right_answer, UNKNOWN)
        return is_wrong and self.probabilities[self.likeliest] >= CONFIDENCE_THRESHOLD


def evaluate_answers(groups: Mapping[str, Sequence[Row]], about: dict[str, Any]) -> StudyResult:
    """Return the figures of each group of rows of `graspwatch grasps`, such as one a library, side by side.

    Raises:
        ConfigurationError: no grasp of a group can be judged.
    """
    study = StudyResult("evaluate", "Answers against the truth", about, EXPLANATION)
    judged: dict[str, list[JudgedGrasp]] = {}
    left_out: dict[str, dict[str, int]] = {}
    for name, rows in groups.items():
        judged[name], left_out[name] = _select(rows)
        if not judged[name]:
            reasons = "; ".join(f"{count} {why}" for why, count in left_out[name].items())
            raise ConfigurationError(
                f"No grasp can be judged ({reasons}). State what was held: on the live page, with `graspwatch label`, "
                "or with --label."
            )
    for name, grasps in judged.items():
        study.figures += _build_figures(f"{name}: " if len(groups) > 1 else "", grasps)
    for name, grasps in judged.items():
        study.parts.append(_build_confusion(name, grasps))
        for what in BREAKDOWNS:
            if what == "truth" or len({each.categories[what] for each in grasps}) > 1:
                study.parts.append(_build_breakdown(what, name, grasps))
        study.parts.append(_build_review_queue(name, grasps))
        study.parts.append(
            Table(f"Left out: {name}", ["grasps", "why"], [[n, why] for why, n in left_out[name].items()])
        )
    study.parts.append(("Reliability", _plot_reliability(judged)))
    return study


def _select(rows: Sequence[Row]) -> tuple[list[JudgedGrasp], dict[str, int]]:
    """Return the grasps that can be judged, and how many others there are, by reason."""
    kept: list[JudgedGrasp] = []
    left_out: dict[str, int] = {}
    for row in rows:
        truth: str = row["truth"] or (row["tissue"] if row["truth_version"] is None else None) or ""
        why = None
        if row["truth_remark"]:
            why = f"of which a person says: {row['truth_remark']}"
        elif not truth:
            why = "without a truth"
        elif not row["valid"]:
            why = f"invalid: {row['why_invalid']}"
        if why:
            left_out[why] = left_out.get(why, 0) + 1
            continue
        probabilities = {
            name.removeprefix(PROBABILITY_PREFIX): value
            for name, value in row.items()
            if name.startswith(PROBABILITY_PREFIX) and value is not None
        }
        kept.append(
            JudgedGrasp(
                row["recording"],
                row["index"],
                truth,
                row["label"],
                probabilities,
                row["time_to_decision_s"],
                {name: str(row[name] or "–") for name in BREAKDOWNS}
                | {"truth": truth, "spot": f"{row['recording']}, {row['spot'] or '–'}"},
            )
        )
    return kept, left_out


def _build_figures(prefix: str, grasps: list[JudgedGrasp]) -> list[KeyFigure]:
    names = sorted({name for each in grasps for name in each.probabilities} | {UNKNOWN})
    table = np.array([[each.probabilities.get(name, 0.0) for name in names] for each in grasps])
    score = score_answers(table, np.array([names.index(each.right_answer) for each in grasps]))
    named = [each for each in grasps if each.is_named]
    wrong = sum(each.label != each.right_answer for each in named)
    confident_and_wrong = sum(each.is_confident_and_wrong for each in grasps)
    decided = [each.decided_s for each in named if each.decided_s is not None]
    loss = float(np.mean([-np.log(max(each.of_truth, LOG_LOSS_FLOOR)) for each in grasps]))
    return [
        KeyFigure(f"{prefix}grasps", len(grasps)),
        KeyFigure(f"{prefix}right by the likeliest", 100 * score.accuracy, "%"),
        KeyFigure(f"{prefix}named right", 100 * (len(named) - wrong) / len(grasps), "%"),
        KeyFigure(f"{prefix}named wrong", 100 * wrong / len(grasps), "%"),
        KeyFigure(f"{prefix}confident and wrong", 100 * confident_and_wrong / len(grasps), "%"),
        KeyFigure(f"{prefix}unknown", 100 * sum(each.label == UNKNOWN for each in grasps) / len(grasps), "%"),
        KeyFigure(f"{prefix}expected calibration error", score.calibration_error),
        KeyFigure(f"{prefix}log loss", loss),
        KeyFigure(f"{prefix}time to decision, median", float(np.median(decided)) if decided else None, "s"),
    ]


def _build_confusion(name: str, grasps: list[JudgedGrasp]) -> Table:
    answers = sorted({each for grasp in grasps for each in grasp.probabilities} - {UNKNOWN})
    answers += [UNKNOWN, UNDECIDED, NO_ANSWER]
    rows = []
    for truth in sorted({each.truth for each in grasps}):
        own = [each.label for each in grasps if each.truth == truth]
        rows.append([truth, len(own), *(own.count(answer) for answer in answers)])
    return Table(f"What was answered: {name}", ["truth", "grasps", *answers], rows)


def _build_breakdown(column: str, name: str, grasps: list[JudgedGrasp]) -> Table:
    rows = []
    for group in sorted({each.categories[column] for each in grasps}):
        own = [each for each in grasps if each.categories[column] == group]
        named = [each for each in own if each.is_named]
        right = sum(each.label == each.right_answer for each in named)
        likeliest = sum(each.likeliest == each.right_answer for each in own)
        probability = float(np.mean([each.of_truth for each in own]))
        rows.append([group, len(own), likeliest, right, len(named) - right, probability])
    columns = [column, "grasps", "likeliest right", "named right", "named wrong", "mean probability of the truth"]
    return Table(f"By {column}: {name}", columns, rows)


def _build_review_queue(name: str, grasps: list[JudgedGrasp]) -> Table:
    """Return the grasps that deserve a second look, those whose answer contradicts the truth most first."""
    queue = sorted(grasps, key=lambda each: (each.of_truth, max(each.probabilities.values())))
    rows = []
    for each in queue[:MAX_REVIEWED]:
        if each.likeliest == each.right_answer and each.is_named:
            continue
        top = each.probabilities[each.likeliest]
        rows.append([each.recording, each.index, each.truth, each.label, each.likeliest, top, each.of_truth])
    columns = ["recording", "grasp", "truth", "answer", "likeliest", "its probability", "probability of the truth"]
    return Table(f"To look at again: {name}", columns, rows)


def _plot_reliability(judged: Mapping[str, list[JudgedGrasp]]) -> go.Figure:
    figure = go.Figure()
    line = {"color": UNKNOWN_COLOR, "dash": "dot"}
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", line=line, name="perfect calibration")
    for (name, grasps), color in zip(judged.items(), PALETTE, strict=False):
        confidence = np.array([each.probabilities[each.likeliest] for each in grasps])
        right = np.array([each.likeliest == each.right_answer for each in grasps])
        mean, share, number = compute_reliability(confidence, right)
        filled = number > 0
        figure.add_scatter(x=mean[filled], y=share[filled], mode="lines+markers", line={"color": color}, name=name)
    figure.update_xaxes(title="probability of the likeliest answer", range=[0, 1])
    figure.update_yaxes(title="share right", range=[0, 1])
    return figure
