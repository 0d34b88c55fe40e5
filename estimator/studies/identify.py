"""`graspwatch study identify`: accuracy, speed and calibration of the answers through the whole sensor chain."""

from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
import plotly.graph_objects as go

from acquisition.sample_block import SampleFlag
from estimator.baselines.paper_filter import PaperIdentifier
from estimator.decision import NOT_NAMED, UNKNOWN
from estimator.filter_bank import (
    ContactStart,
    FilterBank,
    TissuePriors,
    bank_columns,
    build_contact_start,
    build_filter_tunings,
)
from estimator.studies.answer_course import (
    STEP_S,
    ProbabilityHistory,
    StudyConditions,
    build_balanced_cases,
    estimate_grasp,
    load_study_setup,
)
from estimator.studies.case_runner import Progress, run_cases
from estimator.studies.knowledge_limit import KnowledgeLimit, build_limit_figures, compute_case_limit, mean_limit
from estimator.studies.posterior_mode import PosteriorProblem, compute_cramer_rao_bound
from estimator.studies.probability_scores import compute_confusion_matrix, compute_reliability, score_answers
from estimator.studies.simulated_grasps import GraspCase, extract_contact_samples
from estimator.studies.study_report import PALETTE, KeyFigure, StudyResult, Table
from estimator.studies.tissue_colors import assign_tissue_colors

TIMES_S = (0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.5, 1.0)
OURS, LIKELIHOOD_PRODUCT, PAPER_CRITERIA = "ours", "plain likelihoods", "paper's criteria"
PARAMETER_NAMES = ("alpha", "beta", "d")


@dataclass(frozen=True, slots=True)
class _IdentifyOutcome:
    """Results of one grasp."""

    course: ProbabilityHistory
    limit: KnowledgeLimit
    likelihood_product: np.ndarray  # (len(TIMES_S), M + 1): the paper's bank, plain product of innovation likelihoods
    criteria: np.ndarray  # (len(TIMES_S),) index of the guess that the paper's criteria choose
    information: np.ndarray  # (4, 4) of the grasp's samples and the tissue's spread; NaN without contact
    error: np.ndarray  # (3,) ours at the grasp's end; NaN without an estimate


def run_identify_study(
    bench: StudyConditions, grasps: int, seed: int, progress: Progress, jobs: int | None = None
) -> StudyResult:
    """Run the study with `grasps` of each tissue."""
    library = load_study_setup(bench).library
    outcomes = run_cases(partial(_evaluate_case, bench), build_balanced_cases(library, grasps, seed), progress, jobs)
    names = [*library.tissues]
    truth = np.array([names.index(outcome.course.case.tissue) for outcome in outcomes])
    limits = [outcome.limit for outcome in outcomes]
    accuracy_limit = mean_limit(limits, sensed=bench.touch)
    study = StudyResult(
        "identify",
        "How right, how early, how honest",
        {**asdict(bench), "grasps of each tissue": grasps, "seed": seed},
        "Each grasp holds a new specimen, drawn from the library's spreads, on the simulated grasper with its "
        "sensors and its noise. The limit is what the samples allow an ideal observer, from their Fisher information "
        "about alpha, beta and d on the same specimens. With contact sensed it includes the thickness of thin tissue; "
        "without, the zero of the displacement is unknown. A fold's preload has the library's prior. The Bayes "
        "limit knows each specimen's exact parameters: tissues overlap, so nobody can pass it.\n\n"
        "Plain likelihoods and the paper's criteria come from the paper's own filters on the 10 Hz signals.",
    )
    ours = {
        time: score_answers(np.array([o.course.probabilities_at(time) for o in outcomes]), truth) for time in TIMES_S
    }
    study.figures += build_limit_figures(limits, TIMES_S, (0.15, 0.25, 1.0))
    study.figures += _build_floor_figures(bench, ours, dict(zip(TIMES_S, accuracy_limit, strict=True)), len(outcomes))
    study.figures += _build_decision_figures(outcomes)
    study.parts.append(_build_accuracy_table(outcomes, ours, truth, accuracy_limit))
    study.parts.append(_build_parameter_table(study, outcomes, names, fine=bench.noise_mv <= 2.0))
    last = np.array([o.course.probabilities[-1] for o in outcomes])
    answers = compute_confusion_matrix(last, truth, len(names) + 1)
    study.parts.append(
        Table(
            "Confusion at the grasp's end: held (rows), likeliest answer (columns)",
            ["held", *names, UNKNOWN],
            [[name, *map(float, row)] for name, row in zip(names, answers, strict=True)],
        )
    )
    study.parts += [
        ("Share right against time since contact", _plot_accuracy(outcomes, truth, accuracy_limit)),
        ("Reliability: share right against confidence", _plot_reliability(outcomes, truth)),
        ("Time from contact to decision", _plot_times_to_decision(outcomes, names)),
    ]
    return study


def _evaluate_case(bench: StudyConditions, case: GraspCase) -> _IdentifyOutcome:
    lab = load_study_setup(bench)
    course = estimate_grasp(bench, case)
    assert course.grasp is not None
    m = len(lab.library.tissues)
    plain, criteria = np.full((len(TIMES_S), m + 1), 1 / (m + 1)), np.zeros(len(TIMES_S), int)
    information, error = np.full((4, 4), np.nan), np.full(3, np.nan)
    if (course.grasp.samples["contact_tick"] >= 0).any():
        samples = extract_contact_samples(course.grasp)
        paper = PaperIdentifier(lab.tool, lab.library, lab.settings.identification)
        contact = build_contact_start(
            samples[0], 0.0, contact_sensed=bool(samples["flags"][-1] & SampleFlag.CONTACT_SENSED)
        )
        paper.start(samples[0], contact)
        done = 1
        for i, time in enumerate(TIMES_S):
            until = min(round(time * lab.tool.board.sample_rate_hz), len(samples))
            if until > done:
                paper.advance(samples[done:until])
                done = until
            plain[i], criteria[i] = paper.probabilities(), paper.choose_by_criteria()
        information = _information(bench, case.tissue, contact, samples, course.log_parameters)
        found = course.record.alpha_n, course.record.beta_per_m, course.record.damping_kg_per_s
        if None not in found:
            error = np.log(np.array(found, float)) - course.log_parameters
    limit = compute_case_limit(bench, case, TIMES_S, course.grasp)
    return _IdentifyOutcome(replace(course, grasp=None), limit, plain, criteria, information, error)


def _information(
    bench: StudyConditions, tissue: str, contact: ContactStart, samples: np.ndarray, log_parameters: np.ndarray
) -> np.ndarray:
    """Return the Fisher information of the samples for a known tissue, with its spread as prior, (4, 4)."""
    lab = load_study_setup(bench)
    priors = TissuePriors.from_library(lab.library)
    k = priors.names.index(tissue)
    own = TissuePriors((tissue,), priors.mean[k : k + 1], priors.sd[k : k + 1], priors.mass_kg)
    bank = FilterBank(own, build_filter_tunings(lab.tool)[:1], widening=1.0)
    bank.start(contact)
    question = PosteriorProblem.from_bank(
        bank,
        0,
        bank_columns(
            samples,
            float(samples["jaw_displacement_m"][0]),
            int(samples["tick"][0]),
            1.0 / lab.tool.board.sample_rate_hz,
        ),
    )
    return question.compute_gradient_and_information(np.append(log_parameters, np.log(priors.mass_kg)))[1]


def _build_floor_figures(bench: StudyConditions, ours: dict, limit: dict[float, float], count: int) -> list[KeyFigure]:
    """Return the figures with targets at 2 and at 5 mV of strain noise."""
    spread = 100 * np.sqrt(limit[1.0] * (1 - limit[1.0]) / count)
    note = f"one standard deviation of a share from {count} grasps is {spread:.1f} points"
    fine, coarse = bench.noise_mv <= 2.0, 2.0 < bench.noise_mv <= 5.0
    figures = []
    for time, most in ((0.15, 2.0 if fine else None), (0.25, 4.0 if coarse else None), (1.0, 1.0 if fine else None)):
        behind = 100 * (limit[time] - ours[time].accuracy)
        figures.append(
            KeyFigure(f"behind the limit {time:g} s after contact", behind, "points", at_most=most, note=note)
        )
    end = ours[1.0]
    return [
        *figures,
        KeyFigure("expected calibration error at 0.15 s", ours[0.15].calibration_error, "", at_most=0.03),
        KeyFigure("expected calibration error at 1 s", end.calibration_error, "", at_most=0.03),
        KeyFigure("confident (0.95) and wrong at 1 s", 100 * end.confident_wrong, "%", at_most=1.0),
        KeyFigure("confident (0.95) at 1 s", 100 * end.confident, "%"),
    ]


def _build_decision_figures(outcomes: list[_IdentifyOutcome]) -> list[KeyFigure]:
    records = [outcome.course.record for outcome in outcomes]
    decided = [record.time_to_decision_s for record in records if record.time_to_decision_s is not None]
    wrong = sum(r.label not in (*NOT_NAMED, o.course.case.tissue) for r, o in zip(records, outcomes, strict=True))
    withdrawn = sum(any(label not in (o.course.record.label,) for label in o.course.labels) for o in outcomes)
    return [
        KeyFigure(
            "named", 100 * len(decided) / len(records), "%", note="with the bound of the settings, by the grasp's end"
        ),
        KeyFigure("named wrongly", 100 * wrong / len(records), "%"),
        KeyFigure("called unknown", 100 * sum(r.label == UNKNOWN for r in records) / len(records), "%", at_most=3.0),
        KeyFigure("a name withdrawn within the grasp", 100 * withdrawn / len(records), "%"),
        KeyFigure("time to decision, median", float(np.median(decided)) if decided else None, "s"),
    ]


def _build_accuracy_table(outcomes: list[_IdentifyOutcome], ours: dict, truth: np.ndarray, limit: np.ndarray) -> Table:
    rows = []
    for i, time in enumerate(TIMES_S):
        plain = score_answers(np.array([o.likelihood_product[i] for o in outcomes]), truth)
        by_criteria = float((np.array([o.criteria[i] for o in outcomes]) == truth).mean())
        found = ours[time]
        rows.append(
            [
                f"{time:g} s",
                found.accuracy,
                float(limit[i]),
                plain.accuracy,
                by_criteria,
                found.calibration_error,
                plain.calibration_error,
                found.confident_wrong,
                plain.confident_wrong,
            ]
        )
    columns = [
        "after contact",
        OURS,
        "limit",
        LIKELIHOOD_PRODUCT,
        PAPER_CRITERIA,
        f"calibration error, {OURS}",
        f"calibration error, {LIKELIHOOD_PRODUCT}",
        f"confident and wrong, {OURS}",
        f"confident and wrong, {LIKELIHOOD_PRODUCT}",
    ]
    return Table("Share right, and how honest", columns, rows)


def _build_parameter_table(
    study: StudyResult, outcomes: list[_IdentifyOutcome], names: list[str], *, fine: bool
) -> Table:
    """Return the parameters' errors beside the bound, and add figures with targets for 2 mV to the study."""
    rows, all_errors, ratios = [], [], []
    for name in names:
        own = [o for o in outcomes if o.course.case.tissue == name and np.isfinite(o.error).all()]
        if not own:
            continue
        errors = np.array([o.error for o in own])
        bounds = compute_cramer_rao_bound(np.mean([o.information for o in own], axis=0))
        all_errors.append(errors)
        for j, parameter in enumerate(PARAMETER_NAMES):
            rms, bound = float(np.sqrt(np.mean(errors[:, j] ** 2))), float(bounds[j])
            ratios.append(rms / bound)
            median = 100 * float(np.median(np.abs(np.expm1(errors[:, j]))))
            rows.append([f"{name}, {parameter}", median, 100 * 0.6745 * bound, rms, bound, rms / bound])
    pooled = 100 * np.median(np.abs(np.expm1(np.concatenate(all_errors))), axis=0) if all_errors else np.full(3, np.nan)
    for value, most, parameter in zip(pooled, (5.0, 5.0, 15.0), PARAMETER_NAMES, strict=True):
        study.figures.append(
            KeyFigure(f"median error of {parameter}, all tissues", float(value), "%", at_most=most if fine else None)
        )
    if ratios:
        study.figures.append(
            KeyFigure(
                "largest RMS error against its Cramér-Rao bound", max(ratios), "times", at_most=1.5 if fine else None
            )
        )
    columns = ["tissue, parameter", "median error, %", "the bound's, %", "RMS of log", "bound of log", "ratio"]
    return Table("Parameters at the grasp's end, beside the Bayesian Cramér-Rao bound", columns, rows)


def _plot_accuracy(outcomes: list[_IdentifyOutcome], truth: np.ndarray, limit: np.ndarray) -> go.Figure:
    times = np.arange(0.0, 1.0 + STEP_S, 2 * STEP_S)
    ours = [float((np.array([o.course.probabilities_at(t).argmax() for o in outcomes]) == truth).mean()) for t in times]
    figure = go.Figure()
    figure.add_scatter(x=times, y=ours, name=OURS, line={"color": PALETTE[0], "width": 3})
    for name, color, answers in (
        (
            LIKELIHOOD_PRODUCT,
            PALETTE[1],
            [[o.likelihood_product[i].argmax() for o in outcomes] for i in range(len(TIMES_S))],
        ),
        (PAPER_CRITERIA, PALETTE[2], [[o.criteria[i] for o in outcomes] for i in range(len(TIMES_S))]),
    ):
        right = [float((np.array(answer) == truth).mean()) for answer in answers]
        figure.add_scatter(x=TIMES_S, y=right, name=name, mode="lines+markers", line={"color": color})
    figure.add_scatter(x=TIMES_S, y=limit, name="limit", mode="lines", line={"color": "#000000", "dash": "dash"})
    figure.update_layout(xaxis_title="s after contact", yaxis_title="share right", yaxis_range=[0, 1])
    return figure


def _plot_reliability(outcomes: list[_IdentifyOutcome], truth: np.ndarray) -> go.Figure:
    figure = go.Figure()
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", name="honest", line={"dash": "dash", "color": "#999999"})
    last = TIMES_S.index(1.0)
    for name, probabilities, color in (
        (OURS, np.array([o.course.probabilities_at(1.0) for o in outcomes]), PALETTE[0]),
        (LIKELIHOOD_PRODUCT, np.array([o.likelihood_product[last] for o in outcomes]), PALETTE[1]),
    ):
        mean, share, number = compute_reliability(probabilities.max(axis=1), probabilities.argmax(axis=1) == truth)
        figure.add_scatter(
            x=mean,
            y=share,
            text=[f"{n} grasps" for n in number],
            mode="lines+markers",
            name=name,
            line={"color": color},
        )
    figure.update_layout(xaxis_title="confidence", yaxis_title="share right", yaxis_range=[0, 1.02])
    return figure


def _plot_times_to_decision(outcomes: list[_IdentifyOutcome], names: list[str]) -> go.Figure:
    figure = go.Figure()
    colors = assign_tissue_colors(names)
    for name in names:
        own = [o.course.record.time_to_decision_s for o in outcomes if o.course.case.tissue == name]
        decided = np.sort([time for time in own if time is not None])
        share = np.arange(1, len(decided) + 1) / len(own)
        figure.add_scatter(x=decided, y=share, name=name.replace("_", " "), line={"color": colors[name]})
    figure.update_layout(xaxis_title="s after contact", yaxis_title="share named", yaxis_range=[0, 1.02])
    return figure
