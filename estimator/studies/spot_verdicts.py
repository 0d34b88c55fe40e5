"""Study `repeated`: three grasps on one spot, and the verdict of the spot beside the limit for three grasps."""

from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
import plotly.graph_objects as go

from acquisition.sample_block import SAMPLE_DTYPE
from estimator.decision import NOT_NAMED
from estimator.estimate_block import GraspRecord, SpotVerdict
from estimator.online_estimator import TissueEstimator
from estimator.studies.answer_course import StudyConditions, build_balanced_cases, load_study_setup
from estimator.studies.case_runner import Progress, run_cases
from estimator.studies.knowledge_limit import compute_spot_limit
from estimator.studies.probability_scores import score_answers
from estimator.studies.simulated_grasps import GraspCase, simulate_spot, split_into_blocks
from estimator.studies.study_report import KeyFigure, StudyResult, Table

GRASPS = 3
MIN_SHARE_OF_LIMIT = 0.95
MAX_CALIBRATION_ERROR = 0.03


@dataclass(frozen=True, slots=True)
class _SpotOutcome:
    """The verdict of one spot, its grasps by themselves, and the probability that an ideal observer names it right."""

    case: GraspCase
    verdict: SpotVerdict
    grasps: tuple[GraspRecord, ...]
    limit: float


def run_spot_verdict_study(
    bench: StudyConditions, spots: int, seed: int, progress: Progress, jobs: int | None = None
) -> StudyResult:
    """Simulate three grasps on each of `spots` spots of each tissue; compare the verdicts with the best possible."""
    lab = load_study_setup(bench)
    outcomes = run_cases(partial(_evaluate_spot, bench), build_balanced_cases(lab.library, spots, seed), progress, jobs)
    names = [*lab.library.tissues]
    truth = np.array([names.index(each.case.tissue) for each in outcomes])
    found = score_answers(np.array([[*each.verdict.probabilities.values()] for each in outcomes]), truth)
    limit = float(np.mean([each.limit for each in outcomes]))
    named, wrong = _count_named(outcomes)
    alone = sum(grasp.label == each.case.tissue for each in outcomes for grasp in each.grasps)
    study = StudyResult(
        "repeated",
        "Several grasps on one spot",
        {**asdict(bench), "spots of each tissue": spots, "grasps on each": GRASPS, "seed": seed},
        "Each spot is a new specimen, and its grasps differ a little. The limit is what the samples of all grasps "
        "allow an ideal observer to name with the probability of the settings, from their Fisher information.",
    )
    study.figures = [
        KeyFigure("spots named right", 100 * named / len(outcomes), "%"),
        KeyFigure("the limit names", 100 * limit, "%"),
        KeyFigure("named, as a share of the limit", named / len(outcomes) / limit, at_least=MIN_SHARE_OF_LIMIT),
        KeyFigure("spots named wrongly", 100 * wrong / len(outcomes), "%"),
        KeyFigure("spots: likeliest right", 100 * found.accuracy, "%"),
        KeyFigure("expected calibration error", found.calibration_error, at_most=MAX_CALIBRATION_ERROR),
        KeyFigure("single grasps named right", 100 * alone / (GRASPS * len(outcomes)), "%"),
    ]
    rows = [
        [name, *(100 * share for share in _list_shares([each for each in outcomes if each.case.tissue == name]))]
        for name in names
    ]
    columns = ["held", "named right, %", "the limit names, %", "named wrongly, %"]
    study.parts.append(Table("Verdicts of spots, by tissue", columns, rows))
    plot = go.Figure([go.Bar(x=names, y=[row[i] for row in rows], name=columns[i]) for i in (1, 2)])
    study.parts.append(("Named right, and what the limit names, %", plot))
    return study


def _evaluate_spot(bench: StudyConditions, case: GraspCase) -> _SpotOutcome:
    lab = load_study_setup(bench)
    grasps = simulate_spot(lab.tool, lab.library, lab.settings.conditioning, lab.protocol, case, GRASPS)
    session = TissueEstimator(lab.tool, lab.library, lab.settings)
    samples = np.concatenate([grasp.samples for grasp in grasps], dtype=SAMPLE_DTYPE)
    records: list[GraspRecord] = []
    for block in split_into_blocks(samples, lab.tool):
        records += session.process(block).ended
    last = session.finish()
    records += [last] if last else []
    limit = compute_spot_limit(bench, case, grasps, lab.settings.identification.decide_at)
    return _SpotOutcome(case, session.spots[0], tuple(records), limit)


def _count_named(outcomes: list[_SpotOutcome]) -> tuple[int, int]:
    """Return how many spots are named right, and how many wrongly."""
    right = sum(each.verdict.label == each.case.tissue for each in outcomes)
    return right, sum(each.verdict.label not in (*NOT_NAMED, each.case.tissue) for each in outcomes)


def _list_shares(outcomes: list[_SpotOutcome]) -> list[float]:
    right, wrong = _count_named(outcomes)
    count = len(outcomes)
    return [right / count, float(np.mean([each.limit for each in outcomes])), wrong / count]
