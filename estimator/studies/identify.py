"""`graspwatch study identify`: how right, how early and how honest, through the whole sensor chain."""

from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
import plotly.graph_objects as go

from acquisition.blocks import Flag
from config.schema import TissueLibrary
from estimator.bank import Bank, Contact, Priors, strict_and_lenient
from estimator.decision import UNDECIDED, UNKNOWN
from estimator.identifier import bank_columns, contact_of
from estimator.rivals.printed import PrintedIdentifier
from estimator.studies.course import STEP_S, Bench, Course, follow, same_number_of_each, set_up
from estimator.studies.grasps import Case, held_samples
from estimator.studies.measures import bayes_limit, confusion, reliability, score
from estimator.studies.refine import Question, parameter_bound
from estimator.studies.report import COLOURS, PALETTE, Figure, Study, Table
from estimator.studies.runner import Progress, run_cases

TIMES_S = (0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.5, 1.0)
OURS, PLAIN, CRITERIA = "ours", "plain likelihoods", "paper's criteria"
PARAMETERS = ("alpha", "beta", "d")


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What is kept of one grasp."""

    course: Course
    plain: np.ndarray  # (len(TIMES_S), M + 1): the paper's bank, plain product of innovation likelihoods
    criteria: np.ndarray  # (len(TIMES_S),) the guess that the paper's criteria choose
    information: np.ndarray  # (4, 4) of the grasp's samples and the tissue's spread; NaN without contact
    error: np.ndarray  # (3,) ours at the grasp's end; NaN where there is no estimate


def identify(bench: Bench, grasps: int, seed: int, progress: Progress, jobs: int | None = None) -> Study:
    """Run the study: `grasps` of each tissue."""
    library = set_up(bench).library
    outcomes = run_cases(partial(_outcome, bench), same_number_of_each(library, grasps, seed), progress, jobs)
    names = [*library.tissues]
    truth = np.array([names.index(outcome.course.case.tissue) for outcome in outcomes])
    limit = np.array([_limit(bench, library, outcome.course) for outcome in outcomes])
    accuracy_limit = float((limit.argmax(axis=1) == truth).mean())
    study = Study(
        "identify",
        "How right, how early, how honest",
        {**asdict(bench), "grasps of each tissue": grasps, "seed": seed},
        "Each grasp holds a new specimen, drawn from the library's spreads, on the simulated grasper with its "
        "sensors and its noise. The Bayes limit knows each specimen's exact parameters: tissues overlap, so "
        "nobody can pass it.\n\n"
        "Plain likelihoods and the paper's criteria come from the paper's own filters on the 10 Hz signals.",
    )
    ours = {time: score(np.array([o.course.at(time) for o in outcomes]), truth) for time in TIMES_S}
    study.figures += _floors(bench, ours, accuracy_limit, len(outcomes))
    study.figures += _of_decisions(outcomes)
    study.parts.append(_accuracies(outcomes, ours, truth, accuracy_limit))
    study.parts.append(_parameters(study, outcomes, names, fine=bench.noise_mv <= 2.0))
    last = np.array([o.course.probabilities[-1] for o in outcomes])
    answers = confusion(last, truth, len(names) + 1)
    study.parts.append(
        Table(
            "Confusion at the grasp's end: held (rows), likeliest answer (columns)",
            ["held", *names, UNKNOWN],
            [[name, *map(float, row)] for name, row in zip(names, answers, strict=True)],
        )
    )
    study.parts += [
        ("Share right against time since contact", _share_right(outcomes, truth, accuracy_limit)),
        ("Reliability: share right against confidence", _reliability(outcomes, truth)),
        ("Time from contact to decision", _times_to_decision(outcomes, names)),
    ]
    return study


def _outcome(bench: Bench, case: Case) -> _Outcome:
    lab = set_up(bench)
    course = follow(bench, case)
    assert course.grasp is not None
    m = len(lab.library.tissues)
    plain, criteria = np.full((len(TIMES_S), m + 1), 1 / (m + 1)), np.zeros(len(TIMES_S), int)
    information, error = np.full((4, 4), np.nan), np.full(3, np.nan)
    if (course.grasp.samples["contact_tick"] >= 0).any():
        samples = held_samples(course.grasp)
        paper = PrintedIdentifier(lab.tool, lab.library, lab.settings.identification)
        contact = contact_of(samples[0], 0.0, sensed=bool(samples["flags"][-1] & Flag.CONTACT_SENSED))
        paper.start(samples[0], contact)
        done = 1
        for i, time in enumerate(TIMES_S):
            until = min(round(time * lab.tool.board.sample_rate_hz), len(samples))
            if until > done:
                paper.advance(samples[done:until])
                done = until
            plain[i], criteria[i] = paper.probabilities(), paper.by_criteria()
        information = _information(bench, case.tissue, contact, samples, course.log_parameters)
        found = course.record.alpha_n, course.record.beta_per_m, course.record.damping_kg_per_s
        if None not in found:
            error = np.log(np.array(found, float)) - course.log_parameters
    return _Outcome(replace(course, grasp=None), plain, criteria, information, error)


def _information(
    bench: Bench, tissue: str, contact: Contact, samples: np.ndarray, log_parameters: np.ndarray
) -> np.ndarray:
    """What the samples tell whoever knows which tissue it is, (4, 4): its spread is the prior."""
    lab = set_up(bench)
    priors = Priors.of(lab.library)
    k = priors.names.index(tissue)
    own = Priors((tissue,), priors.mean[k : k + 1], priors.sd[k : k + 1], priors.mass_kg)
    bank = Bank(own, strict_and_lenient(lab.tool)[:1], widening=1.0)
    bank.start(contact)
    question = Question.of(
        bank,
        0,
        bank_columns(
            samples,
            float(samples["jaw_displacement_m"][0]),
            int(samples["tick"][0]),
            1.0 / lab.tool.board.sample_rate_hz,
        ),
    )
    return question.gradient(np.append(log_parameters, np.log(priors.mass_kg)))[1]


def _limit(bench: Bench, library: TissueLibrary, course: Course) -> np.ndarray:
    known = bench.thickness and bench.touch
    return bayes_limit(library, course.log_parameters, course.thickness_m if known else None)


def _floors(bench: Bench, ours: dict, limit: float, count: int) -> list[Figure]:
    """The figures that are to be reached at 2 and at 5 mV."""
    spread = 100 * np.sqrt(limit * (1 - limit) / count)
    note = f"one standard deviation of a share from {count} grasps is {spread:.1f} points"
    behind = {time: 100 * (limit - found.accuracy) for time, found in ours.items()}
    fine, coarse = bench.noise_mv <= 2.0, 2.0 < bench.noise_mv <= 5.0
    figures = [Figure("Bayes limit", 100 * limit, "%", note=note)]
    for time, most in ((0.15, 2.0 if fine else None), (0.25, 4.0 if coarse else None), (1.0, 1.0 if fine else None)):
        figures.append(Figure(f"behind the Bayes limit {time:g} s after contact", behind[time], "points", at_most=most))
    end = ours[1.0]
    return [
        *figures,
        Figure("expected calibration error at 0.15 s", ours[0.15].calibration_error, "", at_most=0.03),
        Figure("expected calibration error at 1 s", end.calibration_error, "", at_most=0.03),
        Figure("confident (0.95) and wrong at 1 s", 100 * end.confident_wrong, "%", at_most=1.0),
        Figure("confident (0.95) at 1 s", 100 * end.confident, "%"),
    ]


def _of_decisions(outcomes: list[_Outcome]) -> list[Figure]:
    records = [outcome.course.record for outcome in outcomes]
    decided = [record.time_to_decision_s for record in records if record.time_to_decision_s is not None]
    wrong = sum(r.label not in (UNDECIDED, o.course.case.tissue) for r, o in zip(records, outcomes, strict=True))
    withdrawn = sum(any(label not in (o.course.record.label,) for label in o.course.labels) for o in outcomes)
    return [
        Figure(
            "named", 100 * len(decided) / len(records), "%", note="with the bound of the settings, by the grasp's end"
        ),
        Figure("named wrongly", 100 * wrong / len(records), "%"),
        Figure("called unknown", 100 * sum(r.label == UNKNOWN for r in records) / len(records), "%", at_most=3.0),
        Figure("a name withdrawn within the grasp", 100 * withdrawn / len(records), "%"),
        Figure("time to decision, median", float(np.median(decided)) if decided else None, "s"),
    ]


def _accuracies(outcomes: list[_Outcome], ours: dict, truth: np.ndarray, limit: float) -> Table:
    rows = []
    for i, time in enumerate(TIMES_S):
        plain = score(np.array([o.plain[i] for o in outcomes]), truth)
        by_criteria = float((np.array([o.criteria[i] for o in outcomes]) == truth).mean())
        found = ours[time]
        rows.append(
            [
                f"{time:g} s",
                found.accuracy,
                limit,
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
        "Bayes limit",
        PLAIN,
        CRITERIA,
        f"calibration error, {OURS}",
        f"calibration error, {PLAIN}",
        f"confident and wrong, {OURS}",
        f"confident and wrong, {PLAIN}",
    ]
    return Table("Share right, and how honest", columns, rows)


def _parameters(study: Study, outcomes: list[_Outcome], names: list[str], *, fine: bool) -> Table:
    """Errors of the parameters beside the bound; adds the floors, which hold for 2 mV, to the study's figures."""
    rows, all_errors, ratios = [], [], []
    for name in names:
        own = [o for o in outcomes if o.course.case.tissue == name and np.isfinite(o.error).all()]
        if not own:
            continue
        errors = np.array([o.error for o in own])
        bounds = parameter_bound(np.mean([o.information for o in own], axis=0))
        all_errors.append(errors)
        for j, parameter in enumerate(PARAMETERS):
            rms, bound = float(np.sqrt(np.mean(errors[:, j] ** 2))), float(bounds[j])
            ratios.append(rms / bound)
            median = 100 * float(np.median(np.abs(np.expm1(errors[:, j]))))
            rows.append([f"{name}, {parameter}", median, 100 * 0.6745 * bound, rms, bound, rms / bound])
    pooled = 100 * np.median(np.abs(np.expm1(np.concatenate(all_errors))), axis=0) if all_errors else np.full(3, np.nan)
    for value, most, parameter in zip(pooled, (5.0, 5.0, 15.0), PARAMETERS, strict=True):
        study.figures.append(
            Figure(f"median error of {parameter}, all tissues", float(value), "%", at_most=most if fine else None)
        )
    if ratios:
        study.figures.append(
            Figure(
                "largest RMS error against its Cramér-Rao bound", max(ratios), "times", at_most=1.5 if fine else None
            )
        )
    columns = ["tissue, parameter", "median error, %", "the bound's, %", "RMS of log", "bound of log", "ratio"]
    return Table("Parameters at the grasp's end, beside the Bayesian Cramér-Rao bound", columns, rows)


def _share_right(outcomes: list[_Outcome], truth: np.ndarray, limit: float) -> go.Figure:
    times = np.arange(0.0, 1.0 + STEP_S, 2 * STEP_S)
    ours = [float((np.array([o.course.at(t).argmax() for o in outcomes]) == truth).mean()) for t in times]
    figure = go.Figure()
    figure.add_scatter(x=times, y=ours, name=OURS, line={"color": PALETTE[0], "width": 3})
    for name, color, answers in (
        (PLAIN, PALETTE[1], [[o.plain[i].argmax() for o in outcomes] for i in range(len(TIMES_S))]),
        (CRITERIA, PALETTE[2], [[o.criteria[i] for o in outcomes] for i in range(len(TIMES_S))]),
    ):
        right = [float((np.array(answer) == truth).mean()) for answer in answers]
        figure.add_scatter(x=TIMES_S, y=right, name=name, mode="lines+markers", line={"color": color})
    figure.add_hline(y=limit, line_dash="dash", annotation_text="Bayes limit")
    figure.update_layout(xaxis_title="s after contact", yaxis_title="share right", yaxis_range=[0, 1])
    return figure


def _reliability(outcomes: list[_Outcome], truth: np.ndarray) -> go.Figure:
    figure = go.Figure()
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", name="honest", line={"dash": "dash", "color": "#999999"})
    last = TIMES_S.index(1.0)
    for name, probabilities, color in (
        (OURS, np.array([o.course.at(1.0) for o in outcomes]), PALETTE[0]),
        (PLAIN, np.array([o.plain[last] for o in outcomes]), PALETTE[1]),
    ):
        mean, share, number = reliability(probabilities.max(axis=1), probabilities.argmax(axis=1) == truth)
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


def _times_to_decision(outcomes: list[_Outcome], names: list[str]) -> go.Figure:
    figure = go.Figure()
    for name in names:
        own = [o.course.record.time_to_decision_s for o in outcomes if o.course.case.tissue == name]
        decided = np.sort([time for time in own if time is not None])
        share = np.arange(1, len(decided) + 1) / len(own)
        figure.add_scatter(x=decided, y=share, name=name.replace("_", " "), line={"color": COLOURS.get(name, "#000")})
    figure.update_layout(xaxis_title="s after contact", yaxis_title="share named", yaxis_range=[0, 1.02])
    return figure
