"""`graspwatch study estimators`: comparison of the bank with itself on filterpy and with three other filters."""

import time
from dataclasses import asdict, dataclass

import numpy as np
import plotly.graph_objects as go

from estimator.baselines.filterpy_reference import build_filterpy_identifier
from estimator.baselines.identifier import BankIdentifier, TissueIdentifier
from estimator.baselines.paper_filter import PaperIdentifier
from estimator.baselines.particle_filter import ParticleIdentifier
from estimator.baselines.unscented_filter import build_unscented_identifier
from estimator.filter_bank import build_contact_start
from estimator.studies.answer_course import StudyConditions, StudySetup, build_balanced_cases, load_study_setup
from estimator.studies.case_runner import Progress, run_cases
from estimator.studies.knowledge_limit import KnowledgeLimit, build_limit_figures, compute_case_limit, mean_limit
from estimator.studies.probability_scores import compute_reliability, score_answers
from estimator.studies.simulated_grasps import GraspCase, SimulatedGrasp, extract_contact_samples, simulate_grasp
from estimator.studies.study_report import PALETTE, KeyFigure, StudyResult, Table

TIMES_S = (0.1, 0.15, 0.3)
OURS = "ours"
IDENTIFIER_FACTORIES = {
    OURS: BankIdentifier.from_tool,
    "ours, on filterpy": build_filterpy_identifier,
    "extended, as printed": PaperIdentifier,
    "unscented": build_unscented_identifier,
    "particle": ParticleIdentifier,
}


@dataclass(frozen=True, slots=True)
class _EstimatorOutcome:
    tissue: str
    limit: KnowledgeLimit
    probabilities: np.ndarray  # (estimators, len(TIMES_S), M + 1)
    error: np.ndarray  # (estimators, 3) of log alpha, log beta, log d at the last time
    cost_us: np.ndarray  # (estimators,) per sample


def run_estimators_study(
    bench: StudyConditions, grasps: int, seed: int, progress: Progress, jobs: int | None = None
) -> StudyResult:
    """Run the study with `grasps` of each tissue, the same for all estimators.

    `bench` must have `thickness=False`: the other estimators do not use thickness as evidence.
    """
    library = load_study_setup(bench).library
    names = [*library.tissues]
    cases = [(bench, case) for case in build_balanced_cases(library, grasps, seed)]
    outcomes = run_cases(_evaluate_case, cases, progress, jobs)
    truth = np.array([names.index(o.tissue) for o in outcomes])
    limit = mean_limit([o.limit for o in outcomes], sensed=bench.touch)
    answers = np.array([o.probabilities for o in outcomes])  # (n, estimators, times, M + 1)
    cost = np.median([o.cost_us for o in outcomes], axis=0)
    study = StudyResult(
        "estimators",
        "Which filter",
        {**asdict(bench), "grasps of each tissue": grasps, "seed": seed},
        "All follow the same grasps from contact on, and answer after 0.1, 0.15 and 0.3 s. On filterpy the bank is an "
        "independent implementation, which must answer alike. The unscented and the "
        "particle filter have the states, noise and start of our strict filters, and no lenient ones; the particle "
        "filter moves particles over the parameters and solves the rest exactly. Times are of the filters alone, "
        "while the other cores are busy too. The default is ours as long as nobody is better at a bearable cost.",
    )
    rows = []
    for e, name in enumerate(IDENTIFIER_FACTORIES):
        for i, at in enumerate(TIMES_S):
            found = score_answers(answers[:, e, i], truth)
            rows.append(
                [
                    f"{name}, {at:g} s",
                    found.accuracy,
                    float(limit[i]),
                    found.calibration_error,
                    found.confident_wrong,
                    found.log_loss,
                    float(cost[e]),
                ]
            )
    last = [score_answers(answers[:, e, -1], truth) for e in range(len(IDENTIFIER_FACTORIES))]
    best = min(range(len(IDENTIFIER_FACTORIES)), key=lambda e: last[e].log_loss)
    study.figures = [
        *build_limit_figures([o.limit for o in outcomes], TIMES_S, TIMES_S[-1:]),
        *(
            KeyFigure(f"share right at 0.3 s: {name}", 100 * last[e].accuracy, "%", note=f"{cost[e]:.3g} µs a sample")
            for e, name in enumerate(IDENTIFIER_FACTORIES)
        ),
        KeyFigure("lowest log loss at 0.3 s", last[best].log_loss, "", note=[*IDENTIFIER_FACTORIES][best]),
    ]
    columns = [
        "estimator, after contact",
        "share right",
        "limit",
        "calibration error",
        "confident and wrong",
        "log loss",
        "µs a sample",
    ]
    error_rows = []
    for e, name in enumerate(IDENTIFIER_FACTORIES):
        errors = np.array([o.error[e] for o in outcomes])
        error_rows.append(
            [
                name,
                *(float(v) for v in np.nanmedian(np.abs(np.expm1(errors)), axis=0) * 100),
                100 * float(np.isnan(errors).any(axis=1).mean()),
            ]
        )
    study.parts = [
        Table("Share right, honesty and cost", columns, rows),
        Table(
            "Median error of the likeliest filter's parameters at 0.3 s, %",
            ["estimator", "alpha", "beta", "d", "without an estimate"],
            error_rows,
        ),
        ("Reliability at 0.3 s", _plot_reliability(answers[:, :, -1], truth)),
    ]
    return study


def _evaluate_case(job: tuple[StudyConditions, GraspCase]) -> _EstimatorOutcome:
    bench, case = job
    lab = load_study_setup(bench)
    grasp = simulate_grasp(lab.tool, lab.library, lab.settings.conditioning, lab.protocol, case)
    truth = grasp.specimen.log_parameters
    found = [
        _run_identifier(make(lab.tool, lab.library, lab.settings.identification), lab, bench, grasp)
        for make in IDENTIFIER_FACTORIES.values()
    ]
    return _EstimatorOutcome(
        case.tissue,
        compute_case_limit(bench, case, TIMES_S, grasp),
        np.array([probabilities for probabilities, _, _ in found]),
        np.array([log_parameters - truth for _, log_parameters, _ in found]),
        np.array([cost for _, _, cost in found]),
    )


def _run_identifier(
    identifier: TissueIdentifier, lab: StudySetup, bench: StudyConditions, grasp: SimulatedGrasp
) -> tuple[list[np.ndarray], np.ndarray, float]:
    """Return probabilities at each time, log parameters at the last, and µs per sample without compilation."""
    samples = extract_contact_samples(grasp)
    contact = build_contact_start(samples[0], 0.0, contact_sensed=bench.touch)
    identifier.start(samples[0], contact)
    identifier.advance(samples[1:6])  # compile first
    identifier.start(samples[0], contact)
    probabilities, done, spent_s = [], 1, 0.0
    for at in TIMES_S:
        until = min(round(at * lab.tool.board.sample_rate_hz) + 1, len(samples))
        begin = time.perf_counter()
        for k in range(done, until, lab.tool.board.block_samples):
            identifier.advance(samples[k : min(k + lab.tool.board.block_samples, until)])
        spent_s += time.perf_counter() - begin
        done = max(done, until)
        probabilities.append(identifier.probabilities())
    return probabilities, identifier.log_parameters(), 1e6 * spent_s / max(done - 1, 1)


def _plot_reliability(answers: np.ndarray, truth: np.ndarray) -> go.Figure:
    figure = go.Figure()
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", name="honest", line={"dash": "dash", "color": "#999999"})
    for e, name in enumerate(IDENTIFIER_FACTORIES):
        confidence, right = answers[:, e].max(axis=1), answers[:, e].argmax(axis=1) == truth
        mean, share, number = compute_reliability(confidence, right)
        figure.add_scatter(
            x=mean,
            y=share,
            text=[f"{n} grasps" for n in number],
            name=name,
            mode="lines+markers",
            line={"color": PALETTE[e]},
        )
    figure.update_layout(xaxis_title="confidence", yaxis_title="share right", yaxis_range=[0, 1.02])
    return figure
